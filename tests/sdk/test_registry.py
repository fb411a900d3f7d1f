"""What installed packages register: found without an import, told by name where it is broken or there twice."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.distributions import Install, forget, installing
from xpl import registry
from xpl.registry import ENVS, WIRES, EntryPointError


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    with installing(tmp_path, monkeypatch) as made:
        yield made


def test_what_is_built_in_comes_first_and_is_not_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looking through all distributions takes longer than most of what asks."""
    monkeypatch.setattr(registry, "_installed", lambda: pytest.fail("looked for packages"))
    entry = registry.find(WIRES, "ours", {"ours": "json:dumps"})
    assert entry is not None
    assert entry.load()([1]) == "[1]"
    assert entry.distribution == "xpl"


def test_an_entry_point_is_loaded_when_it_is_used(install: Install) -> None:
    install(
        "one",
        "[xpl.wires]\none = made_one:VALUE\nwhole = made_one\n[other]\nno = nothing\n",
        {"made_one.py": "VALUE = 7"},
    )
    found = registry.entries(WIRES)
    assert {name: entry.distribution for name, entry in found.items()} == {"one": "one 1.0", "whole": "one 1.0"}
    assert (found["one"].load(), found["whole"].load().VALUE) == (7, 7)
    assert registry.find(WIRES, "no") is None


@pytest.mark.parametrize(
    ("value", "module", "told"),
    [
        ("absent_module:X", "", "ModuleNotFoundError: No module named 'absent_module'"),
        ("made_broken:X", "", "has no attribute 'X'"),
        ("made_broken:X", "raise OSError('a\\nb')", r"OSError: a b$"),
    ],
)
def test_a_broken_one_is_one_line_that_names_its_distribution(
    install: Install, monkeypatch: pytest.MonkeyPatch, value: str, module: str, told: str
) -> None:
    monkeypatch.delitem(sys.modules, "made_broken", raising=False)
    install("bad", f"[xpl.wires]\nbad = {value}\n", {"made_broken.py": module})
    with pytest.raises(EntryPointError, match=rf"bad = '{value}' \(xpl.wires\) of bad 1.0 cannot be used: .*{told}"):
        registry.entries(WIRES)["bad"].load()


def test_two_of_one_name_are_an_error_that_names_both(install: Install) -> None:
    install("first", "[xpl.wires]\none = a:X\n[xpl.envs]\none = a\n", {})
    with pytest.raises(EntryPointError, match=r"two are called one in xpl.wires: 'b:Y' of xpl and 'a:X' of first 1.0"):
        registry.entries(WIRES, {"one": "b:Y"})
    install("second", "[xpl.wires]\none = c:Z\n", {})
    with pytest.raises(EntryPointError, match=r"'c:Z' of second 1.0 and 'a:X' of first 1.0"):
        registry.entries(WIRES)
    assert list(registry.entries(ENVS)) == ["one"]


def test_of_one_distribution_the_first_on_the_path_counts(install: Install, monkeypatch: pytest.MonkeyPatch) -> None:
    """As for imports: a checkout may shadow what is installed."""
    site = install("twice", "[xpl.wires]\none = a:X\n", {})
    (site.parent / "other").mkdir()
    for path in site.iterdir():
        (site.parent / "other" / path.name).symlink_to(path)
    monkeypatch.syspath_prepend(site.parent / "other")
    forget()
    assert list(registry.entries(WIRES)) == ["one"]


def test_nothing_is_found_in_the_working_directory(install: Install, monkeypatch: pytest.MonkeyPatch) -> None:
    """`python -m` puts it on the path, and the package that is audited may lie there."""
    site = install("here", "[xpl.wires]\none = a:X\n", {})
    monkeypatch.chdir(site)
    forget()
    assert registry.entries(WIRES) == {}


def test_a_folder_is_found_without_an_import(install: Install) -> None:
    points = "[xpl.envs]\nall = content_pkg.deep.envs\nnone = content_pkg.absent\nno = absent_pkg\n"
    files = {"content_pkg/__init__.py": "raise AssertionError('imported')", "content_pkg/deep/envs/README.md": ""}
    site = install("content", points, files)
    found = registry.entries(ENVS)
    assert found["all"].folder() == site / "content_pkg" / "deep" / "envs"
    with pytest.raises(
        EntryPointError, match=r"of content 1.0 cannot be used: there is no folder absent in .* content_pkg"
    ):
        found["none"].folder()
    with pytest.raises(EntryPointError, match="in a package absent_pkg"):
        found["no"].folder()
    with pytest.raises(EntryPointError, match=r"content_pkg\.absent"):
        registry.folders(ENVS)
