"""What every command of `xpl` has besides its own options: `--output`, and a help text that tells how it ends.

`equip` gives it to all commands of an app at once, so that no command can lack it.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import typer

from xpl_cli.basics import console
from xpl_cli.basics.endings import endings
from xpl_cli.commands.plain import PlainCommand

_OUTPUT: Final = "output"
_COLUMN: Final = 28
"""Widest column of names in a help text; longer names have a line of their own."""


class Command(PlainCommand):
    """A command whose help has its options by panels, and ends with its exit codes and the name of its JSON answer."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, options without a panel, and each panel in the order of its first option, in one column."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                kind = "Arguments" if parameter.param_type_name == "argument" else "Options"
                sections.setdefault(getattr(parameter, "rich_help_panel", None) or kind, []).append(record)
        width = min(_COLUMN, max(len(name) for rows in sections.values() for name, _ in rows))
        for title, rows in sections.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl([(name.ljust(width), told) for name, told in rows])

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write what stands below the options."""
        from xpl_cli.standard import answers

        names = answers.of_command(ctx.command_path)
        with formatter.indentation():
            formatter.write_paragraph()
            if names:
                formatter.write_text(f"With --json: {' or '.join(names)}; `xpl answers` tells their keys.")
            formatter.write_text(endings(self.callback))


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
