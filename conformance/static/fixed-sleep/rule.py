"""XPL138: Scripts wait for readiness, not for a fixed time."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.scripts.flow import PYTHONS, executed_words
from xpl_cli.audit.static.shell import ShellCommand
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, enclosing, last, parents

_FIX = Fix("advice", "wait for the server's ready line or its port, with a timeout")

_SHORT_S: Final = 30.0
"""Longest pause that harms nothing before a wait, s."""
_CONNECTS: Final = re.compile(r"connect|client|socket|urlopen|^(?:get|recv|ping|handshake)$", re.IGNORECASE)


@rule(code="XPL138", requirement="XPL-LOOP-5")
def fixed_sleep(source: Source) -> Iterator[Finding]:
    """A script waits a fixed time for a process to be ready.

    ## What it does
    Looks for `sleep` in the scripts, and `time.sleep` in deploy.py, outside of loops. Inside a loop it is the interval
    of a poll. Pauses of less than a second are not reported, nor those of up to half a minute before a wait: a loop
    that polls, a script with `wait` in its name, or Python code of the adapter that connects again and again.

    ## Why it matters
    On a slower disk the model loads longer than on the author's, and the client finds a closed port. On a faster one
    every run wastes the rest of the time.

    ## Example
    `bash setup_eval_policy_server.sh ... & sleep 60; bash setup_eval_env_client.sh ...`.

    ## Use instead
    `xpl eval`, which waits for the server's ready line; or a loop that polls the port, with a timeout.

    ## Fix safety
    No automatic fix.
    """
    for name in source.text_files:
        if name.endswith(".sh") and "/" not in name:
            commands = source.commands(name)
            for index, command in enumerate(commands):
                if any(before.name in {"kill", "pkill", "killall"} for before in commands[max(index - 2, 0) : index]):
                    continue  # time for a process to end
                if command.name == "sleep" and not command.loops and len(command.arguments) > 1:
                    duration = command.arguments[1]
                    is_negligible = re.fullmatch(r"0?\.\d+s?|0|inf(?:inity)?", duration.text)
                    if not is_negligible and not _is_before_wait(source, duration.text, commands[index + 1 :]):
                        yield Finding(
                            "the script waits a fixed time: on a slower machine the server is not ready yet",
                            path=name,
                            line=command.words[0].line,
                            column=command.words[0].column,
                            expected="a wait for readiness",
                            got=f"sleep {duration.text}",
                            fix=_FIX,
                        )
    yield from _in_loop(source)


def _is_before_wait(source: Source, duration: str, later: Sequence[ShellCommand]) -> bool:
    """Tell whether a pause is short, and what runs after it waits for readiness by itself."""
    seconds = re.fullmatch(r"(\d+(?:\.\d*)?)s?", duration)
    if seconds is None or float(seconds.group(1)) > _SHORT_S:
        return False
    return any(_waits(source, command) for command in later)


def _waits(source: Source, command: ShellCommand) -> bool:
    """Tell whether a command is a poll, a script that waits, or Python code that connects in a loop."""
    words = executed_words(command)
    if (command.name == "sleep" and command.loops) or any("wait" in word.text for word in words[:2]):
        return command.name != "wait"  # for the end of a process
    if not words or not (words[0].text.rpartition("/")[2] in PYTHONS or "python" in words[0].text.lower()):
        return False
    own = [word.text.rpartition("/")[2] for word in words[1:] if word.text.endswith(".py")]
    files = [name for name in own if source.has(name)] or [sdk.File.MODEL_PY, sdk.File.DEPLOY_PY]
    reached = {other for name in files for other in (name, *source.reached(name))}
    return any(_connects_in_loop(source, name) for name in sorted(reached))


def _connects_in_loop(source: Source, name: str) -> bool:
    """Tell whether a file has a loop that tries to connect, and pauses between the attempts."""
    for loop in source.nodes(name) if source.has(name) and source.parses(name) else ():
        if not isinstance(loop, (ast.While, ast.For)):
            continue
        inside = list(ast.walk(loop))
        pauses = any(last(called(node)) in {"sleep", "wait"} for node in inside)
        attempts = [entry for node in inside if isinstance(node, ast.Try) for entry in node.body]
        if pauses and any(_CONNECTS.search(last(called(node))) for entry in attempts for node in ast.walk(entry)):
            return True
    return False


def _in_loop(source: Source) -> Iterator[Finding]:
    name = sdk.File.DEPLOY_PY
    sleeps = (
        [node for node in source.nodes(name) if called(node) in {"time.sleep", "sleep"}] if source.parses(name) else []
    )
    up = parents(source.tree(name)) if sleeps else {}
    for node in sleeps:
        if isinstance(node, ast.Call) and node.args:
            seconds = constant(node.args[0])
            is_poll = any(isinstance(entry, (ast.While, ast.For)) for entry in enclosing(node, up))
            if isinstance(seconds, (int, float)) and seconds >= 1 and not is_poll:
                yield Finding(
                    "the loop waits a fixed time in every episode: too short on one machine, wasted on the other",
                    **source.at(name, node),
                    expected="a wait for readiness",
                    got=ast.unparse(node),
                    fix=_FIX,
                )
