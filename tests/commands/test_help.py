"""The help of every command fits a screen, and mistyped names get suggestions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
import typer

from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode
from xpl_cli.main import app

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LINES, COLUMNS = 50, 80


def _helps(command: Any, name: str, parent: Any = None) -> Iterator[tuple[str, str]]:
    """Yield the name and the help text of a command, and of those in it."""
    context = command.context_class(command, info_name=name, parent=parent, terminal_width=COLUMNS)
    yield context.command_path, command.get_help(context)
    for inner, child in getattr(command, "commands", {}).items():
        yield from _helps(child, inner, context)


@pytest.fixture(scope="module")
def helps() -> dict[str, str]:
    """Return the help texts of all commands by name."""
    return dict(_helps(typer.main.get_command(app), "xpl"))


def test_help_fits_a_screen(helps: dict[str, str]) -> None:
    sizes = {name: (text.count("\n") + 1, max(map(len, text.splitlines()))) for name, text in helps.items()}
    assert len(sizes) > 40
    assert {name: size for name, size in sizes.items() if size[0] > LINES or size[1] > COLUMNS} == {}


def test_a_mistyped_convention_is_suggested_beside_rules(tmp_path: Path) -> None:
    done = xpl("explain", "grippr", cwd=tmp_path)
    assert done.returncode == ExitCode.USAGE
    assert "no rule or convention 'grippr'" in done.stderr
    assert "did you mean gripper or " in done.stderr
