"""XPL169: The loop does what the reference loop does."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.rules.registry import find
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.loops.functions import asked, does, loops
from xpl_cli.audit.static.loops.judge import differences, parted
from xpl_cli.audit.static.loops.values import Unclear
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import names, targets

_OTHERS: Final = (
    "chunk-end",
    "wire-operations",
    "between-actions",
    "chunks-out-of-step",
    "executed-otherwise",
    "stale-observation",
    "error-counted",
)
"""Rules that name one difference each, better than a comparison can."""
_FIX: Final = Fix("advice", "do it as the loop of a fresh scaffold does, which needs nothing of the policy")

_MOVES = ("take_action", "take_action_batch")


@rule(code="XPL169", requirement="XPL-LOOP-10")
def loop_differs(source: Source) -> Iterator[Finding]:
    """The evaluation loop does something else than the reference loop, and it matters.

    ## What it does
    Follows each function of deploy.py and the reference on their syntax trees through the same scripted episodes: ones
    that end inside a chunk and at its seam, environments that end one by one, a policy that fails. Compared is what the
    policy is shown and asked, and what the environment is made to do. Names, logging, progress bars, timing, waiting
    for a frame and bookkeeping leave no trace. Nothing is executed; a condition that nobody can know is taken as
    whichever way is nearer to the reference. What another rule has found in the function is left to that rule.
    A loop that goes back to its beginning whenever the policy answers nothing, and moves nothing before, is reported
    in any case.

    ## Why it matters
    Benchmarks and the audit run loops of their own. A policy whose own loop shows the last observation of a chunk
    twice, adds a text to it, or gives up after 300 steps has another score there, and nothing says why.

    ## Example
    `while not TASK_ENV.is_episode_end() and steps < 300:`, or `obs["instruction"] = PROMPT` before `update_obs`.

    ## Use instead
    The loop of a fresh scaffold. What the policy needs of its input belongs into `encode` of model.py.

    ## Fix safety
    No automatic fix.
    """
    unsaid: list[str] = []
    different = False
    for function in loops(source):
        for node in _endless(function):
            different = True
            yield Finding(
                f"where the policy answers nothing {function.name} asks again for ever: nothing moves the environment, "
                "so that the episode never ends",
                **source.start(function.file, node),
                expected="an error where there is no action",
                got=ast.unparse(node).split("\n")[0],
                fix=_FIX,
            )
        try:
            found = list(differences(function, source))
        except Unclear as why:
            unsaid.append(f"{function.name} cannot be followed without running it: {why}")
            continue
        if found and (code := _named_by(function, source)):
            unsaid.append(f"{code} names what {function.name} does otherwise")
            continue
        for difference in found:
            different = True
            yield Finding(
                f"{function.name} {difference.consequence}",
                **source.start(*(difference.place or (function.file, function.node))),
                expected=difference.expected,
                got=difference.got,
                evidence={"tree": parted(function, source)},
                fix=_FIX,
            )
    if unsaid and not different:
        raise NotApplicable("; ".join(unsaid))


def _endless(function: Function) -> Iterator[ast.If]:
    """Yield branches that go back to the loop's beginning for want of an answer, before anything was executed."""
    answers = {
        target.id
        for node in function.of(ast.Assign)
        if any(id(call) == id(node.value) for call, _ in asked(function))
        for target in targets(node)
        if isinstance(target, ast.Name)
    }
    for loop in function.of(ast.While):
        for place, node in enumerate(loop.body):
            if isinstance(node, ast.If) and isinstance(node.body[-1], ast.Continue) and names(node.test) & answers:
                before = [*loop.body[:place], *node.body]
                if not any(next(does(entry, function, _MOVES), None) for entry in before):
                    yield node


def _named_by(function: Function, source: Source) -> str | None:
    """Return the code of a rule that has found something in a function, None if there is none."""
    here = source.at(function.file, function.node)
    for other in map(find, _OTHERS):
        for finding in other.check(source):
            if (
                isinstance(finding, Finding)
                and finding.path == function.file
                and here["line"] <= (finding.line or 0) <= here["end_line"]
            ):
                return other.code
    return None
