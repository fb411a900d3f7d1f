"""XPL706: What is converted for the model is converted back in its answer."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.dataflow import everywhere_after, sources_of, uses_of
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last, names, self_attribute, texts

_ORDER: Final = re.compile(r"xyzw|wxyz", re.IGNORECASE)
_ROTATES: Final = re.compile(r"quat|rot|euler|matri|6d|axis_?angle|from_|as_|slerp|pose", re.IGNORECASE)
_GRIPS: Final = re.compile(r"grip|convert|invert|binar|discret|threshold", re.IGNORECASE)
"""Names of functions, and of their arguments, that may convert a gripper."""
_DEGREES: Final = frozenset(("rad2deg", "deg2rad", "degrees", "radians"))


@dataclass(frozen=True)
class _Convention:
    """A convention of one kind of value, and what changes it.

    Attributes:
        key: end of the state's and the action's key.
        name: what it is.
        converts: whether an expression converts such a value.
        may_convert: whether it may do so, so that nothing is said.
    """

    key: str
    name: str
    converts: Callable[[ast.AST], bool]
    may_convert: Callable[[ast.AST], bool]


@rule(code="XPL706", requirement="XPL-ACT-14")
def one_way_conversion(source: Source) -> Iterator[Finding]:
    """A convention is converted for the model, and its answer goes out without being converted back.

    ## What it does
    Follows `ee_pose`, `ee_joint_state` and `arm_joint_state` from the observation into the model, and from the model's
    answer into the action: whether a quaternion is reordered, a gripper inverted or scaled, an angle turned into
    degrees. A conversion on one way without one on the other is a warning: a model may answer in another convention
    than that of its input. Nothing is said if a function of another package may convert, or if an attribute keeps the
    value in between.

    ## Why it matters
    The gripper opens where it should close, the hand turns to another orientation, joints hardly move. All checks of
    shapes and ranges pass.

    ## Example
    `state = 1.0 - obs["state"]["ee_joint_state"]`, and `{"ee_joint_state": answer[7:8]}`.

    ## Use instead
    The inverse conversion of the answer; `model_io` in policy.yml declares both at once.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    if adapter.is_sdk:
        return
    functions = adapter.reach(*OBSERVING, *ACTING)
    kept = {write.attribute for function in functions for write in function.writes}
    for convention in _CONVENTIONS:
        read = [(function, node) for function in functions for node in _read(function, convention.key)]
        written = [(function, node) for function in functions for node in _written(function, convention.key)]
        if not read or not written:
            continue
        inward = [part for function, node in read for part in uses_of(adapter, function, node)]
        outward = [part for function, node in written for part in sources_of(adapter, function, node)]
        is_in, is_out = any(map(convention.converts, inward)), any(map(convention.converts, outward))
        if is_in and not is_out and not _is_lost(outward, convention, kept):
            yield _finding(
                source,
                written[0],
                f"{convention.name} is converted for the model, and goes out as the model answered it",
            )
        elif is_out and not is_in:
            after = everywhere_after(adapter, [node for _, node in read])
            if not any(convention.converts(part) or convention.may_convert(part) for part in after):
                yield _finding(
                    source,
                    read[0],
                    f"{convention.name} of the answer is converted, and the model gets the observed one",
                )


def _finding(source: Source, place: tuple[Function, ast.expr], problem: str) -> Finding:
    function, node = place
    return Finding(
        problem,
        **source.at(function.file, node),
        expected="the inverse of the conversion on the other way",
        got=ast.unparse(node)[:80],
        fix=Fix("advice", "convert both ways, or say in a comment in which convention the model observes and answers"),
        must=False,
    )


def _is_lost(parts: list[ast.AST], convention: _Convention, kept: set[str]) -> bool:
    """Tell whether a value may be converted where it is not followed: by a function, or while an attribute keeps it."""
    return any(convention.may_convert(part) or _is_kept(part, kept) for part in parts)


def _is_kept(node: ast.AST, kept: set[str]) -> bool:
    return isinstance(node, ast.Attribute) and self_attribute(node) in kept


def _read(function: Function, key: str) -> Iterator[ast.expr]:
    for node in function.of(ast.Subscript):
        if isinstance(node.ctx, ast.Load) and _ends(node.slice, key):
            yield node
    for call in function.of(ast.Call):
        if isinstance(call.func, ast.Attribute) and call.func.attr == "get" and call.args and _ends(call.args[0], key):
            yield call


def _written(function: Function, key: str) -> Iterator[ast.expr]:
    for node in function.of(ast.Dict):
        pairs = zip(node.keys, node.values, strict=True)
        yield from (value for name, value in pairs if name is not None and _ends(name, key))
    for statement in function.of(ast.Assign):
        for target in statement.targets:
            if not isinstance(target, ast.Subscript) or not _ends(target.slice, key):
                continue
            if sdk.Obs.STATE not in texts(target.value) | names(target.value):  # else it is an observation
                yield statement.value


def _ends(key: ast.expr, end: str) -> bool:
    """Tell whether a key, a constant one or one with the arm's name before, has this end."""
    last_part = key.values[-1] if isinstance(key, ast.JoinedStr) and key.values else key
    text = constant(last_part)
    return isinstance(text, str) and text.endswith(end)


def _reorders(node: ast.AST) -> bool:
    """Tell whether an expression moves the real part of a quaternion to its other end."""
    if isinstance(node, ast.Call):
        return bool(_ORDER.search(last(called(node)))) or last(called(node)) == "roll"
    if isinstance(node, ast.Subscript):
        order = node.slice.elts if isinstance(node.slice, (ast.List, ast.Tuple)) else []
        places = [constant(entry) for entry in order][-4:]
        if len(places) == 4 and all(isinstance(place, int) for place in places):
            least = min(places)
            return [place - least for place in places] in ([1, 2, 3, 0], [3, 0, 1, 2])
    return False


def _turns(node: ast.AST) -> bool:
    """Tell whether a call may compute a rotation, in whatever order."""
    return isinstance(node, ast.Call) and bool(_ROTATES.search(last(called(node))))


def _scales(node: ast.AST) -> bool:
    """Tell whether an expression is arithmetic with a number: an inversion, a scale, a threshold."""
    if isinstance(node, (ast.BinOp, ast.Compare)):
        sides = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.left, *node.comparators)
        return any(isinstance(constant(side), float) or _is_named_number(side) for side in sides)
    return (
        isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant)
    )


def _is_named_number(node: ast.expr) -> bool:
    name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
    return name.isupper() or bool(re.search(r"width|open|stroke|scale|_max$|_min$", name.lower()))


def _may_scale(node: ast.AST) -> bool:
    """Tell whether a call may convert a gripper, by its name or by that of an argument."""
    words = (
        [last(called(node)), *(keyword.arg or "" for keyword in node.keywords)] if isinstance(node, ast.Call) else []
    )
    return any(map(_GRIPS.search, words))


def _to_degrees(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and last(called(node)) in _DEGREES


_CONVENTIONS: Final = (
    _Convention(sdk.State.EE_POSE, "the order of the quaternion", _reorders, _turns),
    _Convention(sdk.State.EE_JOINT_STATE, "the gripper", _scales, _may_scale),
    _Convention(sdk.State.ARM_JOINT_STATE, "the unit of the joints", _to_degrees, _may_scale),
)
