"""A process of ours finds our modules, also where a folder of their name lies in the working directory."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

from xpl_cli.basics import module_command

if TYPE_CHECKING:
    from pathlib import Path


def test_a_folder_that_is_called_as_we_are_hides_nothing(tmp_path: Path) -> None:
    for name in ("xpl", "xpl_cli"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('a stranger')")
    done = subprocess.run(
        [*module_command.command("xpl_cli"), "--version"], cwd=tmp_path, capture_output=True, check=False
    )
    assert done.stdout.startswith(b"xpl "), done.stderr.decode()
