"""How commands end: their exit codes in one sentence, for help texts, pages and agents."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar

from xpl_cli.basics.errors import ExitCode

_Function = TypeVar("_Function", bound=Callable[..., Any])

_MEANINGS: Final = "xpl_meanings"


def exit_codes(**meanings: str) -> Callable[[_Function], _Function]:
    """Say of a command what its exit codes mean, where that can be told more exactly than of all commands.

    Args:
        meanings: by the names of `ExitCode` in small letters.
    """

    def declare(function: _Function) -> _Function:
        setattr(function, _MEANINGS, {ExitCode[name.upper()]: meaning for name, meaning in meanings.items()})
        return function

    return declare


def describe_exit_codes(function: object = None) -> str:
    """Return the sentence on exit codes of a command, of all commands by default."""
    own = own_meanings(function)
    return f"Exit codes: {', '.join(f'{int(code)} {own.get(code, code.meaning)}' for code in ExitCode)}."


def own_meanings(function: object) -> dict[ExitCode, str]:
    """Return what a command says of its exit codes by itself."""
    declared: dict[ExitCode, str] = getattr(function, _MEANINGS, {})
    return declared
