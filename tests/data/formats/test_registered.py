"""Formats are found by name, imported when they are used, and told by their distribution where they are broken."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from tests.data import datasets
from tests.support.distributions import Install, installing
from xpl.registry import EntryPointError
from xpl_cli.basics import formats
from xpl_cli.data.reading import open_set

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

THEIRS = """
from xpl_cli.data.formats import aloha

def recognises(path):
    return (path / "theirs").exists()

def opened(path):
    return aloha.opened(path)
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Return a function that installs a distribution."""
    with installing(tmp_path / "sites", monkeypatch) as made_one:
        yield made_one


@pytest.fixture
def demos(tmp_path: Path) -> Path:
    """Return a folder of the standard's form."""
    (tmp_path / "demos").mkdir()
    datasets.standard(tmp_path / "demos" / "episode.hdf5")
    return tmp_path / "demos"


def test_no_format_is_imported_for_a_command_line() -> None:
    code = """
import sys
from xpl_cli.main import main
main(["audit", "--help"])
main(["data", "list", "--help"])
print(*(name for name in sys.modules if name.startswith(("xpl_cli.audit.formats", "xpl_cli.data"))), file=sys.stderr)
"""
    completed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert completed.stderr.strip() == ""


def test_a_package_is_asked_before_us(install: Install, demos: Path) -> None:
    """It knows something more particular; what it does not recognise is ours as before."""
    install("theirs", "[xpl.formats]\ndata.theirs = made_theirs\n", {"made_theirs.py": THEIRS})
    assert open_set(demos).format == "xpl"
    (demos / "theirs").touch()
    assert open_set(demos).format == "aloha"
    assert "theirs" in formats.registered(formats.DATA)
    assert "theirs" not in formats.registered(formats.REPORT)


@pytest.mark.parametrize(
    "case",
    [
        ("data.bad", "", "it has no function recognises"),
        ("data.bad", "def recognises(path):\n    return 1 / 0\n", "recognises raised ZeroDivisionError"),
        ("bad", "", "its name is neither report.NAME nor data.NAME"),
        ("data.robomimic", "", "two are called data.robomimic"),
    ],
)
def test_a_broken_format_is_told_by_its_distribution(
    install: Install, monkeypatch: pytest.MonkeyPatch, demos: Path, case: tuple[str, str, str]
) -> None:
    name, module, message = case
    monkeypatch.delitem(sys.modules, "made_bad", raising=False)
    install("bad", f"[xpl.formats]\n{name} = made_bad\n", {"made_bad.py": module})
    with pytest.raises(EntryPointError, match=rf"(?s)(of bad 1\.0.*{message}|{message}.*of bad 1\.0)"):
        open_set(demos)
