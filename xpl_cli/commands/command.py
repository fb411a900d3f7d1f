"""Features of every command of `xpl`: the option `--output`, and a help text that ends with the exit codes.

`equip` adds them to all commands of an app.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import typer

from xpl_cli.basics import console
from xpl_cli.basics.exit_codes import describe_exit_codes
from xpl_cli.commands.plain import PlainCommand

_OUTPUT: Final = "output"
_COLUMN: Final = 28
"""Widest column of names in a help text; longer names have a line of their own."""
_SCREEN_LINES: Final = 50
"""Longest help text with blank lines between its sections."""
_LOWER_BOUND: Final = re.compile(r";? ?x>=[0-9.]+(?=\])")


class Command(PlainCommand):
    """A command whose help groups its options by panels, and ends with the schema of its JSON answer and exit codes."""

    def get_help(self, ctx: Any) -> str:
        """Return the help text; where it is longer than a screen, without blank lines between its sections."""
        text: str = super().get_help(ctx)
        return text if text.count("\n") < _SCREEN_LINES else re.sub(r"\n\n(?=[A-Z].*:\n  )", "\n", text)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, options without a panel, and each panel in the order of its first option, in one column."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                kind = "Arguments" if parameter.param_type_name == "argument" else "Options"
                row = (_row_name(parameter, record[0]), _row_text(record[1]))
                sections.setdefault(getattr(parameter, "rich_help_panel", None) or kind, []).append(row)
        width = min(_COLUMN, max(len(name) for rows in sections.values() for name, _ in rows))
        for title, rows in sections.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl([(name.ljust(width), text) for name, text in rows])

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the schema of the JSON answer and the exit codes."""
        from xpl_cli.standard import answers

        names = answers.of_command(ctx.command_path)
        with formatter.indentation():
            formatter.write_paragraph()
            if names:
                formatter.write_text(f"JSON schema: {', '.join(names)} (xpl answers)")
            formatter.write_text(describe_exit_codes(self.callback))


def _row_name(parameter: Any, name: str) -> str:
    """Return the name column of a parameter: its names and one word for its value, such as `--episodes N`."""
    if parameter.param_type_name == "argument":
        return name.partition(" <")[0]
    if parameter.is_flag or parameter.metavar:
        return name
    option = max(parameter.opts, key=len)
    kind = name.partition(option)[2].lower()  # such as `<int range>` or `INTEGER`
    word = "N" if "int" in kind else "X" if "float" in kind else option.rpartition("-")[2].upper()
    return f"{', '.join(parameter.opts)} {word}"


def _row_text(text: str) -> str:
    """Return the text column of a parameter, without bounds such as x>=1 and without `[required]`."""
    return _LOWER_BOUND.sub("", text).replace("[required]", "").replace("[]", "").rstrip()


def equip(app: typer.Typer) -> None:
    """Add `--output` and the help text to every command of an app and of its groups."""
    for info in app.registered_commands:
        info.cls = Command
        info.callback = _with_output(info.callback) if info.callback is not None else None
    for group in app.registered_groups:
        if group.typer_instance is not None:
            equip(group.typer_instance)


def _with_output(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command with `--output`, unless it has its own or prints no answer."""
    signature = inspect.signature(function, eval_str=True)
    if _OUTPUT in signature.parameters or "as_json" not in signature.parameters:
        return function

    @functools.wraps(function)
    def command(*arguments: Any, **options: Any) -> Any:
        with console.output_to(options.pop(_OUTPUT)):
            return function(*arguments, **options)

    option = typer.Option(None, "--output", metavar="FILE", help="Write the answer to a file instead of stdout.")
    kind = inspect.Parameter.KEYWORD_ONLY
    added = inspect.Parameter(_OUTPUT, kind, default=option, annotation=Path | None)
    parameters = [*signature.parameters.values(), added]
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {entry.name: entry.annotation for entry in parameters}
    return command
