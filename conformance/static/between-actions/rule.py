"""XPL136: The loop shows the policy the new observation between the actions of a chunk."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.loops.functions import EXECUTES, does, hands_on, loops, updates
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import enclosing


@rule(code="XPL136", requirement="XPL-LOOP-4")
def between_actions(source: Source) -> Iterator[Finding]:
    """The policy sees no observation between the actions of a chunk.

    ## What it does
    Takes the innermost loop around each `take_action` and asks whether the policy is shown an observation in it.

    ## Why it matters
    Policies that keep a history, or blend overlapping chunks, count observations: one per control step. Shown one per
    chunk, they see the world pass sixteen times too fast.

    ## Example
    `for action in chunk: TASK_ENV.take_action(action)` and nothing else.

    ## Use instead
    `model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())` after each action but the last.

    ## Fix safety
    No automatic fix: it changes what policies with a history are shown.
    """
    for function in loops(source):
        for call in does(function.node, function, EXECUTES):
            loop = next(
                (entry for entry in enclosing(call, function.up) if isinstance(entry, (ast.For, ast.While))), None
            )
            if loop is not None and not updates(loop, function) and not hands_on(loop, function, source, 1):
                yield Finding(
                    f"{function.name} shows the policy one observation per chunk: a history misses all between",
                    **source.at(function.file, call),
                    expected="an observation after each action",
                    got=f"{ast.unparse(loop).splitlines()[0]} without one",
                    fix=Fix("advice", "call update_obs with TASK_ENV.get_obs() after each action"),
                )
                break
