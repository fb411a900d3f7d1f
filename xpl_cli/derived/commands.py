"""The page of all commands, generated from the command line; a test compares it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from xpl_cli.basics.errors import ExitCode
from xpl_cli.basics.exit_codes import describe_exit_codes, own_meanings
from xpl_cli.derived.reference import NOTE, table
from xpl_cli.standard import answers

PAGE = "docs/commands.md"
"""Path of the page in a checkout."""

_INTRODUCTION = """\
Every command, as `--help` shows it. Data goes to standard output, or with `--output FILE` to a file. Everything else
goes to standard error, where lines that begin with `Hint:` say what to do. `--json` prints one object: `schema` names
its format, and `next` lists exact commands that are worth running now. `xpl answers NAME` prints its JSON Schema. A
command that cannot do what you asked answers with `xpl.error/1`.
"""


def page(root: Any) -> str:
    """Return the page, in the order of `xpl --help`, without hidden commands.

    Args:
        root: the whole command line, as typer builds it.
    """
    context = root.make_context(root.name, [], resilient_parsing=True)
    codes = table(("exit code", "of every command"), [(str(int(code)), code.meaning) for code in ExitCode])
    members = [
        line
        for heading, commands in root.headed().items()
        for line in (f"## {heading}", "", *_members(commands, context))
    ]
    return "\n".join([NOTE, "# Commands", "", _INTRODUCTION, *codes, "", *members]).rstrip() + "\n"


def _members(commands: dict[str, Any], parent: object) -> Iterator[str]:
    """Yield the lines of commands, including those of groups."""
    for name, command in commands.items():
        if command.hidden:
            continue
        context = command.make_context(name, [], parent=parent, resilient_parsing=True)
        yield from (f"### {context.command_path}", "", *_paragraphs(command.help), "")
        if hasattr(command, "commands"):
            yield from _members(command.commands, context)
            continue
        parameters = [one for one in command.get_params(context) if not getattr(one, "hidden", False)]
        taken = [_argument(parameter) for parameter in parameters if parameter.param_type_name == "argument"]
        yield from ("```text", " ".join([context.command_path, "[OPTION]...", *taken]), "```", "")
        for panel in dict.fromkeys(map(_panel, parameters)):  # what has none comes first, as in --help
            rows = [(f"`{_name(one)}`", _meaning(one, context)) for one in parameters if _panel(one) == panel]
            yield from (*table((panel or "argument or option", "meaning"), rows), "")
        yield from _ends(command, context)


def _ends(command: Any, context: Any) -> Iterator[str]:
    """Yield the JSON schemas of a command, and its specific exit codes."""
    names = answers.of_command(context.command_path)
    if names:
        yield from (f"With `--json`: {' or '.join(f'`{name}`' for name in names)}.", "")
    if own_meanings(command.callback):
        yield from (describe_exit_codes(command.callback), "")


def _panel(parameter: object) -> str:
    """Return the help panel of a parameter, or an empty text."""
    return str(getattr(parameter, "rich_help_panel", None) or "")


def _paragraphs(text: str) -> Iterator[str]:
    """Yield the lines of a help text as Markdown, without the marks that keep line breaks in a terminal."""
    yield from (line for line in text.splitlines() if line != "\b")


def _argument(parameter: Any) -> str:
    """Return an argument in a usage line: `POLICY`, `[NAME]`, `[PATH]...`."""
    name = _word(parameter)
    return (name if parameter.required else f"[{name}]") + ("..." if parameter.nargs == -1 else "")


def _name(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return _argument(parameter)
    # Short names first; typer gives those of --help in any order.
    names = ", ".join(sorted([*parameter.opts, *parameter.secondary_opts], key=lambda name: name.startswith("--")))
    return names if parameter.is_flag else f"{names} {_word(parameter)}"


def _word(parameter: Any) -> str:
    """Return the placeholder of a value: its metavar or the parameter's name."""
    return str(parameter.metavar or parameter.opts[0].lstrip("-").replace("-", "_").upper()).strip("[].")


def _meaning(parameter: Any, context: Any) -> str:
    """Return the help of a parameter, with its default; angle brackets would be tags in Markdown."""
    _, text = parameter.get_help_record(context)
    return str(text).replace("<", "&lt;")
