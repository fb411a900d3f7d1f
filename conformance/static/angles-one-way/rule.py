"""XPL176: Angles are radians, and what is converted on the way in is converted back."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import Adapter
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.sides import IN, OUT, conversions, words
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last

_CALLS: Final = {"rad2deg": "degrees", "degrees": "degrees", "deg2rad": "radians", "radians": "radians"}
_BY_NAME: Final = {"as_euler": "degrees", "as_rotvec": "degrees", "from_euler": "radians", "from_rotvec": "radians"}
_OTHER: Final = {"degrees": "radians", "radians": "degrees"}
_ELSEWHERE: Final = frozenset(("fov", "fovy", "camera", "intrinsic", "lat", "lon"))


@rule(code="XPL176", requirement="XPL-ACT-14")
def angles_one_way(source: Source) -> Iterator[Finding]:
    """Angles are converted to degrees for the network, and its answer goes out in degrees, or the other way round.

    ## What it does
    Finds conversions between radians and degrees in what observing and acting reach (`np.rad2deg`, `* 180 / np.pi`,
    `as_euler(..., degrees=True)`), and tells by the names around them whether observations or answers are converted.
    One side without the other is reported; where the side of a conversion cannot be told, nothing is.

    ## Why it matters
    An environment takes 30 for thirty radians: the joint goes to its limit at once. The other way round every movement
    is 57 times too small, and the robot seems to be asleep.

    ## Example
    `state = np.rad2deg(obs["state"]["arm_joint_state"])` in `encode`, and a `decode` that unpacks the answer as it is.

    ## Use instead
    `np.deg2rad` in `decode` for what `np.rad2deg` did in `encode`.

    ## Fix safety
    No automatic fix: the network may have been trained with mixed units.
    """
    found = list(conversions(Adapter.of(source), _kind))
    if not found or any(not entry.side for entry in found):
        return
    done = {side: {entry.kind for entry in found if entry.side == side} for side in (IN, OUT)}
    for side, opposite in ((IN, OUT), (OUT, IN)):
        for kind in sorted(done[side]):
            if _OTHER[kind] in done[opposite]:
                continue
            first = next(entry for entry in found if entry.side == side and entry.kind == kind)
            if side == IN:
                message = f"the network is given {kind}, and its answer goes out without being converted back"
            else:
                message = f"answers are converted to {kind}, and what is observed goes in without the opposite"
            yield Finding(
                f"{message}: joints run to their limits, or hardly move",
                **source.at(first.function.file, first.node),
                expected=f"{_OTHER[kind]} on the way {opposite}",
                got=ast.unparse(first.node)[:80],
                fix=Fix("advice", "convert on both ways or on neither"),
            )
            return


def _kind(node: ast.AST, _: Function) -> str | None:
    """Return the unit that a conversion ends in."""
    kind = None
    if isinstance(node, ast.Call):
        name = last(called(node))
        is_degrees = any(entry.arg == "degrees" and constant(entry.value) is True for entry in node.keywords)
        kind = _CALLS.get(name) or (_BY_NAME.get(name) if is_degrees else None)
    elif isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Mult, ast.Div)):
        over: list[ast.expr] = []
        under: list[ast.expr] = []
        _factors(node, over, under)
        if any(constant(part) == 180 for part in over) and any(map(_is_pi, under)):
            kind = "degrees"
        elif any(map(_is_pi, over)) and any(constant(part) == 180 for part in under):
            kind = "radians"
        if kind is not None and len(over) < 2:
            kind = None  # a factor by itself, which is used elsewhere
    return None if kind is None or words(node) & _ELSEWHERE else kind


def _factors(node: ast.expr, over: list[ast.expr], under: list[ast.expr]) -> None:
    """Sort the factors of a product into those above and those below the line."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        _factors(node.left, over, under)
        _factors(node.right, over, under)
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
        _factors(node.left, over, under)
        _factors(node.right, under, over)
    else:
        over.append(node)


def _is_pi(node: ast.expr) -> bool:
    return (isinstance(node, ast.Attribute) and node.attr == "pi") or (isinstance(node, ast.Name) and node.id == "pi")
