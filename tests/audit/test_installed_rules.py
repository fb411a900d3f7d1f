"""Rules that installed packages bring: refused by one line where they cannot be used, and never where they are ours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.distributions import Install, installing
from xpl.registry import EntryPointError
from xpl_cli.audit.rules import registry
from xpl_cli.derived import rules as pages

RULE = '''"""{code}: A rule of a package."""

from xpl_cli.audit import rule


@rule(code="{declared}", requirement="XPL-PKG-6")
def check(source):
    """Nothing."""
    yield from ()
'''


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Return a function that installs a distribution."""
    with installing(tmp_path, monkeypatch) as made:
        yield made


def rule(code: str, declared: str | None = None) -> str:
    """Return the file of a rule."""
    return RULE.format(code=code, declared=declared or code)


def bring(install: Install, place: str, text: str, name: str = "bringer") -> None:
    """Install a package with one rule at GATE/SLUG."""
    install(name, f"[xpl.rules]\n{name} = {name}_pkg.rules\n", {f"{name}_pkg/rules/{place}/rule.py": text})


def test_a_package_brings_a_rule_and_no_page_of_ours_names_it(install: Install) -> None:
    bring(install, "static/theirs", rule("THEIRS101"))
    assert registry.find("theirs").code == "THEIRS101"
    assert [entry.code for entry in registry.select(("THEIRS1",), (), tuple(registry.Gate))] == ["THEIRS101"]
    assert "THEIRS101" not in "".join(pages.pages().values())


@pytest.mark.parametrize(
    ("place", "text", "told"),
    [
        ("nowhere/theirs", rule("THEIRS101"), "in none of the folders of rules"),
        ("static/theirs", rule("XPL199"), "the code 'XPL199': expected letters and three digits"),
        ("static/theirs", "import os\n", "expected letters and three digits"),
        ("static/parses", rule("THEIRS101"), r"parses/rule.py of xpl are both called parses"),
    ],
)
def test_what_is_wrong_at_first_sight_names_the_distribution(
    install: Install, place: str, text: str, told: str
) -> None:
    bring(install, place, text)
    with pytest.raises(EntryPointError, match=rf"of bringer 1.0 cannot be used: .*{told}"):
        registry.entries()


def test_two_packages_with_one_code_are_told(install: Install) -> None:
    bring(install, "static/one", rule("THEIRS101"), "first")
    bring(install, "static/two", rule("THEIRS101"), "second")
    with pytest.raises(EntryPointError, match=r"of (first|second) 1.0 .* are both called THEIRS101"):
        registry.entries()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('"""THEIRS101: Broken."""\nraise OSError("no disk")\n', "OSError: no disk"),
        (rule("THEIRS101", "THEIRS102"), "begins with THEIRS101, and declares THEIRS102"),
    ],
)
def test_a_rule_that_cannot_be_imported_names_the_distribution(install: Install, text: str, told: str) -> None:
    bring(install, "static/theirs", text)
    with pytest.raises(EntryPointError, match=rf"of bringer 1.0 cannot be used: .*{told}$"):
        registry.find("theirs")
