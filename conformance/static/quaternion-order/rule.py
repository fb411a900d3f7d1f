"""XPL150: Quaternions are put into the order of the standard."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import ACTING, OBSERVING, Adapter
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, enclosing, last, names, targets

_REORDERS = re.compile(r"xyzw|wxyz|reorder|roll$|roll\(|scalar_first|convert_quat")
_MAKES_LAST = frozenset(("as_quat", "quaternion_from_matrix", "quaternion_from_euler", "getQuaternionFromEuler"))


@rule(code="XPL150", requirement="XPL-ACT-4")
def quaternion_order(source: Source) -> Iterator[Finding]:
    """A quaternion with its real part last is taken for one of the standard, which has it first.

    ## What it does
    Finds SciPy's `as_quat()` in the acting methods and `from_quat()` of part of a pose in the observing ones, both with
    the real part last unless `scalar_first=True` is given, and looks for anything in the same function, or in those
    that call it, that reorders:
    an index list, `np.roll`, single components, or a function that names an order.

    ## Why it matters
    [x, y, z, w] read as [w, x, y, z] is a valid rotation, only another one: the gripper turns the wrong way, by up to
    180 degrees, and no check of length or norm notices.

    ## Example
    `np.concatenate([position, Rotation.from_rotvec(r).as_quat()])` as an `ee_pose`.

    ## Use instead
    `as_quat(scalar_first=True)` and `from_quat(q, scalar_first=True)`, or `xpl.rotation`.

    ## Fix safety
    Adding `scalar_first=True` needs SciPy 1.14; `q[..., [3, 0, 1, 2]]` does the same everywhere.
    """
    adapter = Adapter.of(source)
    observing, acting = adapter.reach(*OBSERVING), adapter.reach(*ACTING)
    if not any("quat" in source.text(file).lower() for file in {function.file for function in [*observing, *acting]}):
        return
    for function in observing:
        for node in function.of(ast.Call):
            quaternion = node.args[0] if last(called(node)) == "from_quat" and node.args else None
            if quaternion is None or not _is_of_pose(quaternion, function):
                continue
            if not _is_reordered(node, quaternion, function) and not _callers_reorder(adapter, function, observing):
                yield _finding(source, function, node, "[w, x, y, z] of the observation is read as [x, y, z, w]")
    seen = {id(function.node) for function in observing}
    for function in acting:
        for node in function.of(ast.Call) if id(function.node) not in seen else ():
            if last(called(node)) not in _MAKES_LAST or _goes_back(node, function):
                continue
            if not _is_reordered(node, node, function) and not _callers_reorder(adapter, function, acting):
                yield _finding(source, function, node, "[x, y, z, w] goes out where [w, x, y, z] is read")


def _finding(source: Source, function: Function, node: ast.AST, what: str) -> Finding:
    return Finding(
        f"{what}: the gripper is turned to another orientation, and every check of shape and norm passes",
        **source.at(function.file, node),
        expected="[w, x, y, z]: scalar_first=True, or q[..., [3, 0, 1, 2]]",
        got=ast.unparse(node),
        fix=Fix("advice", "give scalar_first=True, or reorder by [3, 0, 1, 2]"),
    )


def _is_of_pose(value: ast.expr, function: Function) -> bool:
    """Tell whether a value is the last part of a pose: `pose[3:7]`, directly or by a name."""
    known = {
        target.id: node.value
        for node in function.nodes
        if isinstance(node, ast.Assign)
        for target in targets(node)
        if isinstance(target, ast.Name)
    }
    value = known.get(value.id, value) if isinstance(value, ast.Name) else value
    if not isinstance(value, ast.Subscript):
        return False
    cut = value.slice.elts[-1] if isinstance(value.slice, ast.Tuple) else value.slice
    return isinstance(cut, ast.Slice) and constant(cut.lower) == 3 and constant(cut.upper) in {7, ...}


def _is_reordered(call: ast.Call, value: ast.expr, function: Function) -> bool:
    """Tell whether the function, or what surrounds the call, puts components into another order."""
    if any(keyword.arg == "scalar_first" for keyword in call.keywords) or _REORDERS.search(function.name):
        return True
    statement = next((outer for outer in enclosing(call, function.up) if isinstance(outer, ast.stmt)), call)
    bound = {name.id for target in targets(statement) for name in ast.walk(target) if isinstance(name, ast.Name)}
    if len(targets(statement)) > 2 and isinstance(statement, ast.Assign) and statement.value is call:
        return True  # x, y, z, w = ...
    about = bound | names(value)
    for node in function.nodes:
        if isinstance(node, ast.Call) and _REORDERS.search(called(node)) and (names(node) & about or node is not call):
            return True
        if isinstance(node, ast.Subscript) and _reorders(node.slice):
            return True
    return any(_REORDERS.search(name) for name in bound)


def _callers_reorder(adapter: Adapter, function: Function, functions: list[Function], depth: int = 3) -> bool:
    """Tell whether a function that gets the result, or gives the quaternion, puts components into another order."""
    for caller in functions if depth else ():
        if caller is function or not any(adapter.callee(caller, call) is function for call in caller.of(ast.Call)):
            continue
        if any(_reorders(node.slice) for node in caller.of(ast.Subscript)):
            return True
        if any(_REORDERS.search(called(call)) for call in caller.of(ast.Call)):
            return True
        if _callers_reorder(adapter, caller, functions, depth - 1):
            return True
    return False


def _reorders(index: ast.expr) -> bool:
    """Tell whether an index picks components: a list of them, or the last or fourth alone."""
    cut = index.elts[-1] if isinstance(index, ast.Tuple) and index.elts else index
    if isinstance(cut, ast.List):
        return len(cut.elts) == 4
    if isinstance(cut, ast.Slice):
        return constant(cut.lower) in {-1, 3} and constant(cut.upper) in {None, 4} and cut.upper is not None
    return constant(cut) in {3, -1}


def _goes_back(call: ast.Call, function: Function) -> bool:
    """Tell whether a quaternion goes straight into a function of the same library."""
    outer = function.up.get(call)
    return isinstance(outer, ast.Call) and last(called(outer)) in {"from_quat", "Rotation"}
