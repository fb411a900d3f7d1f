"""XPL138: Scripts wait for readiness, not for a fixed time."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, enclosing, parents

_FIX = Fix("advice", "wait for the server's ready line or its port, with a timeout")


@rule(code="XPL138", requirement="XPL-LOOP-5")
def fixed_sleep(source: Source) -> Iterator[Finding]:
    """A script waits a fixed time for a process to be ready.

    ## What it does
    Looks for `sleep` in the scripts, and `time.sleep` in deploy.py, outside of loops. Inside a loop it is the interval
    of a poll. Pauses of less than a second are not reported.

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
                    if not re.fullmatch(r"0?\.\d+s?|0|inf(?:inity)?", duration.text):
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
