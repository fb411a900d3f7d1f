"""What docs/environments.md shows is what the commands give."""

import re
import shlex
from pathlib import Path

import pytest

from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode
from xpl_cli.environments import listing

pytest.importorskip("mujoco")

DOCS = ROOT / "docs"
PAGE = (DOCS / "environments.md").read_text(encoding="utf-8")


def test_the_table_of_tasks_is_that_of_the_manifest() -> None:
    table = PAGE.split("a test compares them -->")[1].split("<!-- /tasks -->")[0].strip()
    assert table == listing.markdown(listing.offers("mujoco"))


@pytest.mark.slow
def test_the_first_commands_work(tmp_path: Path) -> None:
    block = re.findall(r"```console\n(.*?)```", PAGE, flags=re.DOTALL)[0]
    for line in block.splitlines():
        done = xpl(*shlex.split(line)[1:], cwd=tmp_path)
        assert done.returncode == ExitCode.CLEAN, (line, done.stdout, done.stderr)
    assert (tmp_path / "lift.webp").stat().st_size > 1000
