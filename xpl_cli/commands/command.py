"""What every command of `xpl` has besides its own options: `--output`, and a help text that tells how it ends.

`equip` gives it to all commands of an app at once, so that no command can lack it.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

import typer

from xpl_cli.basics import console
from xpl_cli.basics.errors import ExitCode
from xpl_cli.commands.plain import PlainCommand

_Function = TypeVar("_Function", bound=Callable[..., Any])

_MEANINGS: Final = "xpl_meanings"
_OUTPUT: Final = "output"


class Command(PlainCommand):
    """A command whose help ends with its exit codes and the name of its JSON answer."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write what stands below the options."""
        from xpl_cli.standard import answers

        names = answers.of_command(ctx.command_path)
        with formatter.indentation():
            formatter.write_paragraph()
            if names:
                formatter.write_text(f"With --json: {' or '.join(names)}; `xpl answers` tells their keys.")
            formatter.write_text(endings(self.callback))


def ends(**meanings: str) -> Callable[[_Function], _Function]:
    """Say of a command what its exit codes mean, where that can be told more exactly than of all commands.

    Args:
        meanings: by the names of `ExitCode` in small letters.
    """

    def declare(function: _Function) -> _Function:
        setattr(function, _MEANINGS, {ExitCode[name.upper()]: meaning for name, meaning in meanings.items()})
        return function

    return declare


def endings(function: Any = None) -> str:
    """Return the sentence on exit codes of a command, of all commands by default."""
    own = own_meanings(function)
    return f"Exit codes: {', '.join(f'{int(code)} {own.get(code, code.meaning)}' for code in ExitCode)}."


def own_meanings(function: Any) -> dict[ExitCode, str]:
    """Return what a command says of its exit codes by itself."""
    declared: dict[ExitCode, str] = getattr(function, _MEANINGS, {})
    return declared


def equip(app: typer.Typer) -> None:
    """Give `--output` and its help text to every command of an app, and of those in it."""
    for info in app.registered_commands:
        info.cls = Command
        info.callback = _with_output(info.callback) if info.callback is not None else None
    for group in app.registered_groups:
        if group.typer_instance is not None:
            equip(group.typer_instance)


def _with_output(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command with `--output`, unless it has its own or answers nothing."""
    signature = inspect.signature(function, eval_str=True)
    if _OUTPUT in signature.parameters or "as_json" not in signature.parameters:
        return function

    @functools.wraps(function)
    def command(*arguments: Any, **options: Any) -> Any:
        with console.into(options.pop(_OUTPUT)):
            return function(*arguments, **options)

    option = typer.Option(None, "--output", metavar="FILE", help="Write the answer to a file instead of stdout.")
    kind = inspect.Parameter.KEYWORD_ONLY
    added = inspect.Parameter(_OUTPUT, kind, default=option, annotation=Path | None)
    parameters = [*signature.parameters.values(), added]
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {entry.name: entry.annotation for entry in parameters}
    return command
