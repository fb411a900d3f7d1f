"""How a command ends that cannot do what it was asked: one sentence and a hint, and for programs `xpl.error/1`."""

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
    """Return what a command with --json answers instead of its result."""
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
    """Return a command line that was not understood as an error of ours, with what it could have been.

    Args:
        error: the parser's `UsageError`; typer brings its own, or takes that of click.
    """
    context = error.ctx
    path = "xpl" if context is None else context.command_path
    message = error.format_message().rstrip(".")
    if (option := getattr(error, "option_name", None)) is not None and context is not None:
        return no_such(f"{path} has no option {option}", option, _options(context), listing=f"{path} --help")
    if message.startswith("No such command") and (given := _QUOTED.search(message)) is not None:
        known = [name for name, command in context.command.commands.items() if not command.hidden]
        return no_such(f"{path} has no command {given[1]!r}", given[1], known, listing=f"{path} --help")
    return UserError(f"{path}: {message[:1].lower()}{message[1:]}", hint=f"`{path} --help` tells what it takes")


def from_exception(error: Exception) -> UserError:
    """Return what a command did not foresee as an error: of the system, of an installed package, or our own fault."""
    from xpl.registry import EntryPointError

    if isinstance(error, EntryPointError):
        hint = "the fault is the named package's: mend or uninstall it"
        return UserError(str(error), hint=hint, code=ExitCode.NOT_RUN)
    return from_os_error(error) if isinstance(error, OSError) else from_fault(error)


def from_os_error(error: OSError) -> UserError:
    """Return what the system refused, such as a file, a port or memory, as an error."""
    reason = error.strerror or str(error) or type(error).__name__
    where = "" if error.filename is None else f"{error.filename!s:.200}: "
    return UserError(
        f"{where}{reason[:1].lower()}{reason[1:]}",
        hint="XPL_DEBUG=1 shows where it was asked for",
        code=ExitCode.NOT_RUN,
    )


def from_fault(error: Exception) -> UserError:
    """Return a fault of the tool itself as an error."""
    return UserError(
        f"internal error: {type(error).__name__}: {error}",
        hint="this is a fault of xpl; run again with XPL_DEBUG=1 for the traceback and report it",
        code=ExitCode.INTERNAL,
    )


def format_error(error: UserError) -> str:
    """Return the error as people read it."""
    head = "" if error.code in (ExitCode.INTERNAL, ExitCode.INTERRUPTED) else "error: "
    hint = f"Hint: {error.hint}\n" if error.hint else ""
    told = _CONTINUED.sub("\n  ", str(error))  # what was given may hold line ends, and no line of it is one of ours
    return f"{head}{told}\n{hint}"


def _options(context: Any) -> list[str]:
    return [name for parameter in context.command.get_params(context) for name in parameter.opts if name[:1] == "-"]


def _following(hint: str | None) -> list[str]:
    """Return the commands that a hint offers, without those that name something in capitals to be filled in."""
    found = [] if hint is None else _COMMAND.findall(hint)
    return [command for command in found if not any(word.isupper() and word.isalpha() for word in command.split())]
