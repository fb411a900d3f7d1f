"""XPL703: get_action returns a list of action steps with the keys of the standard."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.answers import Answer, ListAnswer, MapAnswer, returned
from xpl_cli.audit.static.model_class import ACT, ACT_BATCH, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec

_SHOWN = 6
_MAP = "a map where a list belongs: loops that play a chunk fail on it"


@rule(code="XPL703", requirement="XPL-ACT-1")
def action_form(source: Source) -> Iterator[Finding]:
    """get_action returns something else than a list of action steps with the keys of the standard.

    ## What it does
    Follows what `get_action` and `get_action_batch` return, as far as the adapter's own code shows it: a map where a
    list belongs, and action steps with keys that the action schema does not have.

    ## Why it matters
    The reference loop, and every environment but the author's, executes lists of action steps by the names of the
    standard. A further key is refused, or the motion that it holds is never executed.

    ## Example
    `return {"actions": chunk.tolist()}`.

    ## Use instead
    `return [{"arm_joint_state": row[:6], "ee_joint_state": row[6:]} for row in chunk]`; `xpl.action.unpack` makes it.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    known = {name for form in spec.schema("action")["$defs"].values() for name in form["properties"]}
    reported: set[tuple[str, int]] = set()
    for name, depth in ((ACT, 1), (ACT_BATCH, 2)):
        function = adapter.method(name)
        for answer in returned(adapter, function) if function is not None else ():
            judged = _judged(answer, depth, known)
            if judged is None or (judged[0].function.file, judged[0].node.lineno) in reported:
                continue
            made, problem, got = judged
            reported.add((made.function.file, made.node.lineno))
            yield Finding(
                f"{name} returns {problem}",
                **source.start(made.function.file, made.node),
                expected=f"{'a list by environment of ' if depth > 1 else ''}a list of action steps with keys such as "
                "left_arm_joint_state",
                got=got,
                fix=Fix("advice", "xpl.action.unpack makes action steps with the keys of the robot and action type"),
            )


def _judged(answer: Answer, depth: int, known: set[str]) -> tuple[MapAnswer, str, str] | None:
    """Return the map that is at the wrong place or has wrong keys, what is wrong, and what came."""
    below: Answer | None = answer
    levels = 0
    while isinstance(below, ListAnswer) and levels < depth:
        below, levels = below.item, levels + 1
    if not isinstance(below, MapAnswer):
        return None
    if levels < depth:
        return None if levels == 0 and depth > 1 and not below.keys else (below, _MAP, _keys(below))
    strange = sorted(below.keys - known)
    if not strange or (not below.is_complete and not below.keys & known):
        return None
    text = f"action steps with {', '.join(strange[:_SHOWN])}, which the standard does not have"
    consequence = "an environment refuses them, or never executes what they hold"
    if not below.keys & known:
        text, consequence = f"{text}, and with none of its keys", "no environment can execute them"
    return below, f"{text}: {consequence}", _keys(below)


def _keys(answer: MapAnswer) -> str:
    return f"a map with {', '.join(sorted(answer.keys)[:_SHOWN]) or 'keys that are computed'}"
