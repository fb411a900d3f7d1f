"""Exit codes of commands in one sentence, for help texts, pages and agents."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar

from xpl_cli.basics.errors import ExitCode

_Function = TypeVar("_Function", bound=Callable[..., Any])

_MEANINGS: Final = "xpl_meanings"


def exit_codes(**meanings: str) -> Callable[[_Function], _Function]:
    """Declare the meanings of a command's exit codes, where they are more specific than the common ones.

    Args:
        meanings: by the lower-case names of `ExitCode`.
    """

    def declare(function: _Function) -> _Function:
        setattr(function, _MEANINGS, {ExitCode[name.upper()]: meaning for name, meaning in meanings.items()})
        return function

    return declare


def describe_exit_codes(function: object = None) -> str:
    """Return the sentence on the exit codes of a command; by default, of all commands."""
    own = own_meanings(function)
    return f"Exit codes: {', '.join(f'{int(code)} {own.get(code, code.meaning)}' for code in ExitCode)}."


def own_meanings(function: object) -> dict[ExitCode, str]:
    """Return the meanings that a command declares for its exit codes."""
    declared: dict[ExitCode, str] = getattr(function, _MEANINGS, {})
    return declared
