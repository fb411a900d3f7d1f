"""Reports of failed commands: one sentence and a hint for users, and `xpl.error/1` for programs."""

from __future__ import annotations

import itertools
import re
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.basics.errors import ExitCode, UserError, no_such

if TYPE_CHECKING:
    from collections.abc import Sequence

SCHEMA: Final = "xpl.error/1"

_COMMAND = re.compile(r"`(xpl [^`]+)`")
_CONTINUED = re.compile(r"\r?\n(?=\S)")
_QUOTED = re.compile(r"'(.*?)'")
_JSON: Final = frozenset(("--json", "--format=json"))


def wants_json(arguments: Sequence[str]) -> bool:
    """Tell whether a command line asks for JSON."""
    return not _JSON.isdisjoint(arguments) or ("--format", "json") in itertools.pairwise(arguments)


def document(error: UserError) -> dict[str, object]:
    """Return the JSON answer for an error."""
    return {
        "schema": SCHEMA,
        "kind": error.code.name.lower(),
        "message": str(error).partition("\n")[0],
        "hint": error.hint,
        "exit_code": int(error.code),
        "given": None,
        "choices": [],
        "nearest": [],
        "file": None,
        "problems": [],
        "next": _following(error.hint),
        **error.details(),
    }


def from_usage_error(error: Any) -> UserError:
    """Convert a usage error of the parser, with suggestions.

    Args:
        error: the parser's `UsageError`; typer's own or click's.
    """
    context = error.ctx
    path = "xpl" if context is None else context.command_path
    message = error.format_message().rstrip(".")
    if (option := getattr(error, "option_name", None)) is not None and context is not None:
        return no_such(f"{path} has no option {option}", option, _options(context), listing=f"{path} --help")
    if message.startswith("No such command") and (match := _QUOTED.search(message)) is not None:
        names = [name for name, command in context.command.commands.items() if not command.hidden]
        return no_such(f"{path} has no command {match[1]!r}", match[1], names, listing=f"{path} --help")
    return UserError(f"{path}: {message[:1].lower()}{message[1:]}", hint=f"`{path} --help` tells what it takes")


def from_exception(error: Exception) -> UserError:
    """Convert an unexpected exception: an error of the system, of an installed package, or a fault of xpl."""
    from xpl.registry import EntryPointError

    if isinstance(error, EntryPointError):
        hint = "the fault is in the named package: fix or uninstall it"
        return UserError(str(error), hint=hint, code=ExitCode.NOT_RUN)
    return from_os_error(error) if isinstance(error, OSError) else from_fault(error)


def from_os_error(error: OSError) -> UserError:
    """Convert an error of the system, such as for a file, a port or memory."""
    reason = error.strerror or str(error) or type(error).__name__
    where = "" if error.filename is None else f"{error.filename!s:.200}: "
    return UserError(
        f"{where}{reason[:1].lower()}{reason[1:]}",
        hint="XPL_DEBUG=1 shows the traceback",
        code=ExitCode.NOT_RUN,
    )


def from_fault(error: Exception) -> UserError:
    """Convert a fault of xpl itself."""
    return UserError(
        f"internal error: {type(error).__name__}: {error}",
        hint="this is a fault of xpl; run again with XPL_DEBUG=1 for the traceback and report it",
        code=ExitCode.INTERNAL,
    )


def format_error(error: UserError) -> str:
    """Return an error as text for users."""
    head = "" if error.code in (ExitCode.INTERNAL, ExitCode.INTERRUPTED) else "error: "
    hint = f"Hint: {error.hint}\n" if error.hint else ""
    message = _CONTINUED.sub(
        "\n  ", str(error)
    )  # untrusted line ends are indented, so that no line looks like one of xpl
    return f"{head}{message}\n{hint}"


def _options(context: Any) -> list[str]:
    return [name for parameter in context.command.get_params(context) for name in parameter.opts if name[:1] == "-"]


def _following(hint: str | None) -> list[str]:
    """Return the commands in a hint, without those that have placeholders in capitals."""
    commands = [] if hint is None else _COMMAND.findall(hint)
    return [command for command in commands if not any(word.isupper() and word.isalpha() for word in command.split())]
