"""XPL157: Scripts end the processes that they started, and no other ones."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.scripts.flow import (
    PYTHONS,
    executed_words,
    only_prints,
    quote_command,
    scripts,
    word_location,
)
from xpl_cli.audit.static.shell import ShellCommand, ShellScript
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec

_BY_NAME = frozenset(("pkill", "killall", "fuser"))
_DETACHED = re.compile(r"tmux new\S* .*-\w*d|screen -\w*d")

_LAUNCHER = re.compile(r"(?:^|[_-])(?:start|launch|serve|spawn|up|daemon)(?:[_.-]|$)")
_STANDARD = frozenset(spec.data("package")["scripts"])
"""Scripts that others call and wait for."""
_MULTIPLEXERS: Final = frozenset(("tmux", "screen"))
_GUIDE: Final = re.compile(r"\btmux\s+(?:a|at|attach\S*|kill-ses\S*|ls)\b|\bscreen\s+-(?:r|x|ls|S\s+\S+\s+-X)\b")
"""How a person attaches to a session, or ends it."""


@rule(code="XPL157", requirement="XPL-PKG-11")
def stray_processes(source: Source) -> Iterator[Finding]:
    """A process outlives the script that started it, or the script ends processes of other users.

    ## What it does
    Looks for background processes that are neither waited for nor ended in an exit trap; for a server that is ended by
    the id of the shell that started it, if that shell does not `exec` the server; and for processes that are ended by
    name. A script called `start_...` or `launch_...` is meant to leave processes running, and so is one that starts
    sessions of tmux or screen and does nothing after that, or tells a person how to attach to them; but for the scripts
    of the standard, which others wait for.

    ## Why it matters
    A server that is left running keeps GPU memory and the port. The next run fails, or connects to the old model.
    Ending processes by name also ends the evaluations of other users on the machine.

    ## Example
    `kill "$SERVER_PID"` where that is `bash setup_eval_policy_server.sh`, whose last line is `python serve.py` without
    `exec`: the shell ends, and Python continues.

    ## Use instead
    `trap 'kill "$SERVER_PID"' EXIT` before the first command that may fail, and `exec python ...` in the server's
    script.

    ## Fix safety
    Safe: `exec` before the last command of a script without traps changes nothing else.
    """
    has_finding = False
    for name, commands in scripts(source):
        has_finding = True
        yield from _left(source, name, commands)
        yield from _by_name(name, commands)
    if not has_finding:
        raise NotApplicable("the adapter has no scripts")
    yield from _orphaned(source)


def _left(source: Source, name: str, commands: ShellScript) -> Iterator[Finding]:
    """Yield what runs in the background when the script ends."""
    if _LAUNCHER.search(name) and name not in _STANDARD:
        return  # what it starts is meant to go on
    started = [
        (place, command)
        for place, command in enumerate(commands)
        if command.end == "&" or command.name in _MULTIPLEXERS
    ]
    if not started or any(command.name == "wait" for command in commands):
        return
    has_trap = any(
        command.name == "trap" and {word.text for word in command.words} & {"EXIT", "0"} for command in commands
    )
    are_sessions_meant = name not in _STANDARD and _leaves_sessions(source, name, commands)
    for place, command in started:
        words = executed_words(command)
        is_detached = _DETACHED.match(" ".join(word.text for word in words)) is not None
        if not words or has_trap or (command.end != "&" and (not is_detached or are_sessions_meant)):
            continue
        kills = _ends_later(commands, place)
        if kills and "errexit" not in commands.options:
            continue
        when = "if a later step fails, " if kills else ""
        yield Finding(
            f"{when}`{quote_command(words, 2)}` continues to run after {name} has ended: it keeps its GPU memory and "
            "its port",
            **word_location(name, words[0]),
            expected="trap 'kill \"$pid\"' EXIT, or wait",
            got=f"{quote_command(words, 2)} in the background, "
            + ("ended only in the last lines" if kills else "never ended"),
            fix=Fix("advice", "store `$!`, and end it in `trap ... EXIT`"),
        )


def _ends_later(commands: ShellScript, place: int) -> bool:
    """Tell whether a script ends processes after it started the one at `place`; before, it ends those of a former run.

    Functions count wherever they stand.
    """
    return any(
        "kill" in word.raw
        for later, command in enumerate(commands)
        if later > place or command.functions
        for word in command.words
        if not only_prints(command)
    )


def _leaves_sessions(source: Source, name: str, commands: ShellScript) -> bool:
    """Tell whether sessions of a script are its purpose: nothing needs them later, or it says how to attach to them."""
    last = max((place for place, command in enumerate(commands) if command.name in _MULTIPLEXERS), default=0)
    if all(map(only_prints, commands[last + 1 :])):
        return True
    executed = {word.line for command in commands if command.name in _MULTIPLEXERS for word in command.words}
    lines = enumerate(source.text(name).splitlines(), 1)
    return any(_GUIDE.search(line) for number, line in lines if number not in executed)


def _by_name(name: str, commands: ShellScript) -> Iterator[Finding]:
    for command in commands:
        if command.name not in _BY_NAME or any("$" in word.raw or word.raw == "-P" for word in command.words):
            continue
        if command.name == "fuser" and not any(word.raw.startswith("-") and "k" in word.raw for word in command.words):
            continue
        yield Finding(
            f"`{quote_command(command.arguments)}` also ends processes that {name} did not start: other runs stop",
            **word_location(name, command.arguments[0]),
            expected="kill with the process id that the script stored",
            got=quote_command(command.arguments),
            fix=Fix("advice", "store `$!` of what the script starts, and end that"),
        )


def _orphaned(source: Source) -> Iterator[Finding]:
    """Yield a server that goes on when the shell around it is ended by its id."""
    caller, called = sdk.File.EVAL_SH, sdk.File.SETUP_EVAL_POLICY_SERVER_SH
    if not source.has(caller) or not source.has(called):
        return
    outer, inner = source.commands(caller), source.commands(called)
    if not _starts(outer, called) or not _ends_one(outer) or not inner:
        return
    last = inner[-1]
    words = executed_words(last)
    name = words[0].text.rpartition("/")[2].upper() if words else ""
    is_server = name in {"UV", *map(str.upper, PYTHONS)} or "PYTHON" in name
    if is_server and last.name != "exec" and last.end != "&":
        yield Finding(
            f"{caller} ends the shell of {called} and not the server in it, which keeps its GPU memory and its port",
            **word_location(called, last.words[0]),
            expected=f"exec {quote_command(words, 1)}",
            got=quote_command(words, 2),
            fix=Fix("advice", f"exec {quote_command(words, 1)} ..., or start it in its own group and end the group"),
        )


def _starts(outer: ShellScript, called: str) -> bool:
    """Tell whether a script starts another one in the background, in the same process group."""
    names = {name for command in outer for name, value in command.assignments if called in value.raw}
    return any(command.end == "&" and _names(command, called, names) and command.name != "setsid" for command in outer)


def _names(command: ShellCommand, called: str, variables: set[str]) -> bool:
    return any(
        called in word.raw or any(item.name in variables for item in word.expansions) for word in command.arguments[:3]
    )


def _ends_one(outer: ShellScript) -> bool:
    """Tell whether a script ends single processes only: no process group, no children."""
    kills = [command for command in outer if command.name == "kill"]
    words = [word.text for command in kills for word in command.arguments[1:]]
    by_group = any(text == "--" or text.startswith("-$") for text in words) or any(
        command.name == "pkill" or any("jobs -p" in word.raw for word in command.words) for command in outer
    )
    return bool(kills) and not by_group
