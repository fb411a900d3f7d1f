"""XPL169: The evaluation loop does not retry get_action forever."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.loops import EXECUTES, environment_calls, loops, policy_calls
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import names, targets


@rule(code="XPL169", requirement="XPL-LOOP-10")
def endless_retry(source: Source) -> Iterator[Finding]:
    """The evaluation loop calls get_action again forever if the policy returns nothing.

    ## What it does
    Finds in the functions of deploy.py a `while` loop that starts over, depending on the policy's action chunk, before
    any action was executed.

    ## Why it matters
    The robot does not move, so the next chunk is the same and the episode never ends: one failed policy blocks a whole
    benchmark.

    ## Example
    `actions = model_client.call(func_name="get_action")`, then `if actions is None: continue`.

    ## Use instead
    The loop of a fresh scaffold, in which a result that is not an action chunk is an error.

    ## Fix safety
    No automatic fix.
    """
    for function in loops(source):
        for node in _endless(function):
            yield Finding(
                f"if the policy returns nothing, {function.name} calls it again forever: no action is executed, "
                "so the episode never ends",
                **source.start(function.file, node),
                expected="an error if there is no action",
                got=ast.unparse(node).split("\n")[0],
                fix=Fix("advice", "copy the loop of a fresh scaffold, which raises an error there"),
            )


def _endless(function: Function) -> Iterator[ast.If]:
    """Yield branches that go back to the loop's beginning for want of an answer, before anything was executed."""
    answers = {
        target.id
        for node in function.of(ast.Assign)
        if any(id(call) == id(node.value) for call, _ in policy_calls(function))
        for target in targets(node)
        if isinstance(target, ast.Name)
    }
    for loop in function.of(ast.While):
        for index, node in enumerate(loop.body):
            if isinstance(node, ast.If) and isinstance(node.body[-1], ast.Continue) and names(node.test) & answers:
                before = [*loop.body[:index], *node.body]
                if not any(next(environment_calls(entry, function, EXECUTES), None) for entry in before):
                    yield node
