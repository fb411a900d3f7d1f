"""XPL165: What the loop shows the policy is the present observation."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import RESET
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.loops.functions import EXECUTES, UPDATES, around, asked, does, hands_on, loops
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import targets


@rule(code="XPL165", requirement="XPL-LOOP-8")
def stale_observation(source: Source) -> Iterator[Finding]:
    """The loop shows the policy an observation from before the action, or makes it forget in mid-episode.

    ## What it does
    Takes each `update_obs` in a loop that executes actions, and asks when the variable it is given was last assigned:
    before the loop, or before the action. A `reset` of the policy inside the loop over the episode is reported too.

    ## Why it matters
    The policy plans again and again from a picture of the past: the arm repeats the first motion, and nothing fails. A
    reset in mid-episode takes history, ensembling and the random sequence away.

    ## Example
    `obs = TASK_ENV.get_obs()` before `for action in actions: TASK_ENV.take_action(action); update_obs(obs)`.

    ## Use instead
    `model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())` after each action.

    ## Fix safety
    No automatic fix.
    """
    for function in loops(source):
        for call, name in asked(function):
            shown = _shown(call) if name in UPDATES else None
            loop = around(call, function) if shown or name == RESET else None
            if loop is None or not any(does(loop, function, EXECUTES)):
                continue
            if name == RESET:
                yield _finding(source, function, call, "resets the policy in mid-episode: it forgets what it saw")
            elif (since := _since(call, shown, loop, function)) and not hands_on(loop, function, source, 0):
                yield _finding(source, function, call, f"shows the policy {shown} from before {since}, as if new")


def _shown(call: ast.Call) -> str | None:
    """Return the variable that an update shows, if it is one."""
    values = [keyword.value for keyword in call.keywords if keyword.arg == sdk.Payload.OBS] or call.args[-1:]
    return values[0].id if values and isinstance(values[0], ast.Name) else None


def _since(call: ast.Call, name: str | None, loop: ast.For | ast.While, function: Function) -> str | None:
    """Return since when a variable is old when a call in a loop shows it, or None if it is new."""
    made = [
        node.lineno
        for node in ast.walk(loop)
        if isinstance(node, (ast.Assign, ast.AnnAssign, ast.NamedExpr, ast.For))
        for target in targets(node)
        if isinstance(target, ast.Name) and target.id == name
    ]
    if not made:
        return "the loop"
    last = max((line for line in made if line <= call.lineno), default=call.lineno)
    acts = (act.lineno for act in does(loop, function, EXECUTES) if around(act, function) is loop)
    return "the action" if any(last < line < call.lineno for line in acts) else None


def _finding(source: Source, function: Function, call: ast.Call, what: str) -> Finding:
    return Finding(
        f"{function.name} {what}",
        **source.at(function.file, call),
        expected="a new observation after each action, and one reset at the beginning",
        got=ast.unparse(call)[:80],
        fix=Fix("advice", "take the observation after the action, and reset before the loop"),
    )
