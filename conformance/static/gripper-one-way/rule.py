"""XPL177: A gripper that is turned round on the way in is turned round on the way out."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import ACTING, Adapter
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.sides import IN, OUT, conversions, words
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last, targets

_INVERTED: Final = "inverted"
_KEY: Final = sdk.State.EE_JOINT_STATE
_WORDS: Final = frozenset(("gripper", "grippers", "grip", "grasp", "claw"))


@rule(code="XPL177", requirement="XPL-ACT-14")
def gripper_one_way(source: Source) -> Iterator[Finding]:
    """The gripper's direction is turned round in observations only, or in answers only.

    ## What it does
    Finds `1 - gripper` in what observing and acting reach, and tells by the names around it whether what was observed
    or what is answered is turned round. It is reported if only one of the two is, and the code handles the gripper on
    the other way as well.

    ## Why it matters
    In the standard 0 is closed and 1 is open on both ways. With one of them turned round, the policy sees an open
    gripper and believes it closed: it opens where it should grasp.

    ## Example
    `gripper = 1.0 - obs["state"]["ee_joint_state"]` in `encode`, and the network's gripper as it is in `decode`.

    ## Use instead
    The same `1.0 - ...` in `decode`, or in neither.

    ## Fix safety
    No automatic fix: the network may answer in another convention than it observes.
    """
    adapter = Adapter.of(source)
    found = list(conversions(adapter, _kind))
    sides = {entry.side for entry in found}
    if len(sides) != 1 or "" in sides:
        return
    (side,) = sides
    if side == IN and not adapter.is_sdk and not _answers(adapter):
        return
    first = found[0]
    done, other = ("in observations", "answers") if side == IN else ("in answers", "observations")
    yield Finding(
        f"the gripper is turned round {done} and not in {other}: the policy opens where it should grasp",
        **source.at(first.function.file, first.node),
        expected=f"1 - gripper on the way {OUT if side == IN else IN} too",
        got=ast.unparse(first.node)[:80],
        fix=Fix("advice", "turn the gripper round on both ways or on neither"),
    )


def _answers(adapter: Adapter) -> bool:
    """Tell whether the adapter writes the gripper's command itself."""
    for function in adapter.reach(*ACTING):
        keys = [key for table in function.of(ast.Dict) for key in table.keys]
        keys += [node.slice for node in function.of(ast.Subscript) if isinstance(node.ctx, ast.Store)]
        if any(key is not None and _names_it(words(key), key) for key in keys):
            return True
    return False


def _kind(node: ast.AST, function: Function) -> str | None:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub) and constant(node.left) == 1:
        statement = function.up.get(node, node)
        named = [node.right, *targets(statement)]  # what is subtracted, and what becomes of it
        return _INVERTED if any(_names_it(words(entry), entry) for entry in named) else None
    if isinstance(node, ast.Call) and last(called(node)) in {"invert_gripper", "flip_gripper", "inverted_gripper"}:
        return _INVERTED
    return None


def _names_it(found: set[str], node: ast.AST) -> bool:
    return bool(found & _WORDS) or any(
        _KEY in str(value).lower()
        for child in ast.walk(node)
        for value in (getattr(child, "id", ""), getattr(child, "attr", ""), getattr(child, "value", ""))
        if isinstance(value, str)
    )
