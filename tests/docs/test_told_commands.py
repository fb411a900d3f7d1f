"""What skills and other texts tell to type is what the command line takes."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.support.places import ROOT, tracked
from tests.support.told import Command, commands, fault
from xpl_cli.main import app

SKILLS = tracked(".agents/skills/*/SKILL.md", ".agents/skills/*/references/*.md")
TEXTS = [
    *SKILLS,
    ROOT / "AGENTS.md",
    *tracked("envs/*/README.md"),
    ROOT / "templates/agents/AGENTS.md",
]
"""What people and agents read beside the documentation, whose pages have tests of their own."""

HARMLESS = ("--version", "doctor", "rules", "explain", "spec show", "env list", "skills get")
"""Commands that change nothing, need no adapter and are quick; `doctor` is tried by its own tests."""

VALUES = {"RULE": "XPL203", "ROBOT": "franka_single", "ENVIRONMENT": "mujoco", "SKILL": "xpl-audit-policy"}


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_command_exists(path: Path) -> None:
    assert [told for command in commands(path) if (told := fault(command))] == []


def _harmless() -> list[Command]:
    told = {command for path in SKILLS for command in commands(path) if command.exact}
    quick = [command for command in told if str(command).removeprefix("xpl ").startswith(HARMLESS)]
    return sorted((command for command in quick if command.words[0] != "doctor"), key=str)


@pytest.mark.parametrize("command", _harmless(), ids=str)
def test_harmless_commands_of_skills_run(command: Command) -> None:
    done = CliRunner().invoke(app, [VALUES.get(word, word) for word in command.words])
    assert done.exit_code == 0, done.exception
    assert done.stdout


@pytest.mark.parametrize(
    ("words", "exact", "told"),
    [
        ("audit policy/Foo --gate static", True, None),
        ("eval POLICY --episodes N", True, None),
        ("audti policy/Foo", True, "there is no audti"),
        ("explain", True, "RULE"),
        ("eval POLICY --episodes many", True, "many"),
        ("audit POLICY --deep", True, "--deep"),
        ("env list|check", False, None),
        ("env list|chekc", False, "there is no chekc"),
        ("explain", False, None),
        ("audit --deep", False, "there is no --deep"),
        ("audit ...", False, None),
    ],
)
def test_what_does_not_exist_is_noticed(words: str, told: str | None, exact: bool) -> None:
    found = fault(Command(tuple(words.split()), exact))
    assert found is None if told is None else told in str(found)
