"""XPL136: The evaluation loop calls update_obs between the actions of a chunk."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.loops import EXECUTES, environment_calls, loops, passes_on, policy_calls, sends_observation
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import enclosing, names, targets

_OBSERVES = ("get_obs", "get_obs_batch")


@rule(code="XPL136", requirement="XPL-LOOP-4")
def observe_every_step(source: Source) -> Iterator[Finding]:
    """The evaluation loop does not call update_obs between the actions of a chunk.

    ## What it does
    Takes the innermost loop around each `take_action` and checks that the loop sends the policy an observation, by
    `update_obs` or by another call that gets one which the loop reads.

    ## Why it matters
    Policies that keep a history, or use temporal ensembling, expect one observation per control step. With one per
    chunk of sixteen actions, time seems to pass sixteen times too fast for them.

    ## Example
    `for action in chunk: TASK_ENV.take_action(action)` and nothing else.

    ## Use instead
    `model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())` after each action but the last.

    ## Fix safety
    No automatic fix: it changes the observations that policies with a history get.
    """
    for function in loops(source):
        for call in environment_calls(function.node, function, EXECUTES):
            loop = next(
                (entry for entry in enclosing(call, function.up) if isinstance(entry, (ast.For, ast.While))), None
            )
            is_shown = loop is not None and (sends_observation(loop, function) or _hands_fresh(loop, function))
            if loop is not None and not is_shown and not passes_on(loop, function, source, 1):
                yield Finding(
                    f"{function.name} sends the policy one observation per chunk: a history lacks all in between",
                    **source.at(function.file, call),
                    expected="an observation after each action",
                    got=f"{ast.unparse(loop).splitlines()[0]} without one",
                    fix=Fix("advice", "call update_obs with TASK_ENV.get_obs() after each action"),
                )
                break


def _hands_fresh(loop: ast.For | ast.While, function: Function) -> bool:
    """Tell whether a call to the policy in a loop is given an observation that the same loop takes."""
    inside = set(map(id, ast.walk(loop)))
    taken = {
        target.id
        for node in ast.walk(loop)
        if isinstance(node, (ast.Assign, ast.AnnAssign, ast.NamedExpr)) and node.value is not None
        if any(environment_calls(node.value, function, _OBSERVES))
        for target in targets(node)
        if isinstance(target, ast.Name)
    }
    return any(
        names(value) & taken or any(environment_calls(value, function, _OBSERVES))
        for call, _ in policy_calls(function)
        if id(call) in inside
        for value in (*call.args, *(keyword.value for keyword in call.keywords))
    )
