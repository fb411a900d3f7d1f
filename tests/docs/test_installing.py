"""What pages and hints tell users to install can be installed: a checkout, a wheel, or libraries of an index."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.checkout import tracked
from xpl_cli.basics.extras import how_to_install

FILES = ("README.md", "CONTRIBUTING.md", "action.yml")
ROOMS = ("docs", "templates", ".agents", "policy", "envs", "xpl", "xpl_cli")
_BY_NAME = re.compile(r"""pip install [^\n|`]*(?<![\w/.])xpl[-_]cli\b""")
"""The tool by its bare name, which only an index could know; a path before it is a file or a folder."""


def _texts() -> list[Path]:
    paths = tracked(*FILES, *(f"{room}/**" for room in ROOMS))
    return [path for path in paths if path.suffix not in {".png", ".npz", ".npy", ".bin"}]


def test_nothing_tells_to_install_a_name_that_is_on_no_index() -> None:
    paths = _texts()
    assert len(paths) > 300
    offending = [str(path) for path in paths if _BY_NAME.search(path.read_text(encoding="utf-8", errors="replace"))]
    assert offending == []


@pytest.mark.parametrize(("extra", "library"), [("hub", "huggingface"), ("ray", "ray")])
def test_a_missing_extra_is_told_by_its_libraries(extra: str, library: str) -> None:
    assert re.fullmatch(rf"pip install '{library}[-_\w]*[<>=][^ ]+'", how_to_install(extra))
