"""XPL151: A rotation by 180 degrees is preserved."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last, names, parameters, targets

_ARCS = frozenset(("arccos", "acos"))
_LENGTHS = frozenset(("norm", "sin"))


@rule(code="XPL151", requirement="XPL-ACT-4")
def half_turn(source: Source) -> Iterator[Finding]:
    """A rotation by 180 degrees becomes no rotation at all.

    ## What it does
    Looks for functions that compute an angle from the trace of a rotation matrix and its axis from the differences of
    its off-diagonal elements, and that return zeros if the length of that axis, or the sine of the angle, is small.
    Both are small at 180 degrees too. A test of the angle itself is correct.

    ## Why it matters
    A gripper that points straight down is often a half turn away from the base. The policy gets the orientation of one
    that points up, and its actions command the arm to turn the gripper over.

    ## Example
    `if np.linalg.norm(axis) < 1e-12: return np.zeros(3)`.

    ## Use instead
    `xpl.rotation.to_axis_angle`, which computes the axis from the diagonal at 180 degrees.

    ## Fix safety
    No automatic fix.
    """
    for function in ModelClass.of(source).reach(*OBSERVING, *ACTING):
        if not any(last(called(node)) in _ARCS for node in function.of(ast.Call)):
            continue
        if not _is_of_matrix(function):
            continue
        for node in _mistaken(function):
            yield Finding(
                f"{function.name} returns no rotation for one by 180 degrees: a gripper that points down is "
                "treated as one that points up",
                **source.at(function.file, node),
                expected="the axis from the diagonal of the matrix if the angle is close to pi",
                got=ast.unparse(node).split("\n")[0],
                fix=Fix("advice", "use xpl.rotation.to_axis_angle, or compute the axis from (R + I) / 2 there"),
            )


def _is_of_matrix(function: Function) -> bool:
    """Tell whether a function takes an axis from the differences of opposite entries: `R[2, 1] - R[1, 2]`."""
    for node in function.of(ast.BinOp):
        if isinstance(node.op, ast.Sub):
            first, second = _place(node.left), _place(node.right)
            if first is not None and second is not None and first == second[::-1]:
                return True
    return False


def _place(node: ast.expr) -> list[object] | None:
    """Return the indices of an entry of a matrix, written as `R[2, 1]` or `R[2][1]`."""
    if not isinstance(node, ast.Subscript):
        return None
    if isinstance(node.value, ast.Subscript):
        return [constant(node.value.slice), constant(node.slice)]
    if isinstance(node.slice, ast.Tuple) and len(node.slice.elts) >= 2:
        return [constant(entry) for entry in node.slice.elts[-2:]]
    return None


def _mistaken(function: Function) -> Iterator[ast.AST]:
    """Yield the tests of a length or a sine that end in zeros, in a function that has no case for a half turn."""
    small = {
        target.id
        for node in function.nodes
        if isinstance(node, ast.Assign) and any(last(called(child)) in _LENGTHS for child in ast.walk(node.value))
        for target in targets(node)
        if isinstance(target, ast.Name)
    } - set(parameters(function.node))
    mentions_pi = any(isinstance(node, ast.Attribute) and node.attr == "pi" for node in function.nodes)
    for node in function.nodes if not mentions_pi else ():
        if isinstance(node, ast.If) and _is_small(node.test, small):
            value = getattr(node.body[-1], "value", None)
            if isinstance(node.body[-1], (ast.Return, ast.Assign)) and isinstance(value, ast.expr) and _is_none(value):
                yield node.test


def _is_small(test: ast.expr, small: set[str]) -> bool:
    if not isinstance(test, ast.Compare) or not isinstance(test.ops[0], (ast.Lt, ast.LtE)):
        return False
    direct = any(last(called(child)) in _LENGTHS for child in ast.walk(test.left))
    return direct or bool(names(test.left) & small)


def _is_none(value: ast.expr) -> bool:
    return any(last(called(node)) in {"zeros", "zeros_like"} for node in ast.walk(value)) or (
        isinstance(value, (ast.List, ast.Tuple)) and all(constant(entry) == 0 for entry in value.elts)
    )
