"""XPL125: Dimensions come from the embodiment."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from itertools import accumulate

from xpl import _spec as sdk
from xpl.robots import shipped
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import constant, dotted, enclosing, last, texts

_STATE = (sdk.State.ARM_JOINT_STATE, sdk.State.EE_JOINT_STATE)
_FEWEST_CUTS = 3
_COORDINATES = 6
_FIX = Fix("advice", "use the dimensions of self.embodiment, or xpl.action.pack and unpack")

_OLD = re.compile(r"legacy|compat|deprecated|(?:^|_)old(?:_|$)", re.IGNORECASE)
_ROBOT = re.compile(r"robot|embodiment|env_cfg", re.IGNORECASE)


@cache
def _layouts() -> list[tuple[str, frozenset[int], int]]:
    """Return, for each robot: its arms in words, where values begin and end in its packed vectors, and their length.

    Arms of fewer joints than a pose has coordinates are left out: their vectors are as long as poses.
    """
    layouts = []
    for robot in shipped.entries().values():
        if robot["arm"]["dof"] < _COORDINATES:
            continue
        sizes = [(robot["arm"]["dof"], robot["end_effector"]["dim"])] * len(robot["arms"])
        packed = [size for pair in sizes for size in pair]
        grouped = [pair[0] for pair in sizes] + [pair[1] for pair in sizes]
        bounds = {0, *accumulate(packed), *accumulate(grouped)}
        arms = f"{len(sizes)} arm{'s' * (len(sizes) > 1)} of {sizes[0][0]} joints"
        layouts.append((arms, frozenset(bounds), sum(packed)))
    return layouts


@rule(code="XPL125", requirement="XPL-ACT-6")
def fixed_dimensions(source: Source) -> Iterator[Finding]:
    """The adapter slices vectors by the dimensions of one robot.

    ## What it does
    Looks for joint and gripper values that are sliced at constants, and for packed vectors that are split by three or
    more constant slices which form the layout of a robot. Not reported: code that runs only for a robot that it
    compares by name, or only for old checkpoints.

    ## Why it matters
    On a robot with seven joints the seventh is dropped, or treated as the gripper. The shapes still fit, so the arm
    moves to a wrong pose without an error.

    ## Example
    `state["left_arm_joint_state"][:6]`.

    ## Use instead
    `xpl.observation.pack_state` and `xpl.action.unpack`, or `arm.dof` of `self.embodiment.arms`.

    ## Fix safety
    No automatic fix.
    """
    reported: set[tuple[str, int]] = set()
    for function in ModelClass.of(source).reach(*ModelClass.of(source).methods):
        for node, message in (*_cut_values(function), *_layout(function)):
            function_key = (function.file, id(function.node))
            if function_key not in reported and not _is_guarded(node, function):
                reported.add(function_key)
                yield _finding(source, function.file, node, message)


def _is_guarded(node: ast.AST, function: Function) -> bool:
    """Tell whether code runs for one robot only, that it asks for by name, or for what was trained long ago."""
    if _OLD.search(function.name):
        return True
    inner = node
    for outer in enclosing(node, function.up):
        if isinstance(outer, (ast.If, ast.IfExp)) and inner is not outer.test:
            words = {last(dotted(child)) for child in ast.walk(outer.test)} | texts(outer.test)
            if any(_OLD.search(word) for word in words if word):
                return True
            body = outer.body if isinstance(outer.body, list) else [outer.body]
            if inner in body and _names_robot(outer.test):
                return True
        inner = outer
    return False


def _names_robot(test: ast.expr) -> bool:
    """Tell whether a test holds for robots of a certain name only: `robot == "arx"`, `self.robot in ("arx", "x5")`."""
    return any(
        isinstance(node, ast.Compare)
        and isinstance(node.ops[0], (ast.Eq, ast.In))
        and any(
            _ROBOT.search(last(dotted(part))) or any(map(_ROBOT.search, texts(part))) for part in ast.walk(node.left)
        )
        and bool(texts(node.comparators[0]))
        for node in ast.walk(test)
    )


def _finding(source: Source, file: str, node: ast.AST, message: str) -> Finding:
    return Finding(
        message,
        **source.at(file, node),
        expected="dimensions of the embodiment",
        got=ast.unparse(node),
        fix=_FIX,
    )


def _bounds(node: ast.AST) -> tuple[int, int | None] | None:
    """Return the constant bounds of a slice of the last axis."""
    inner = node.slice if isinstance(node, ast.Subscript) else None
    if isinstance(inner, ast.Tuple) and inner.elts:
        inner = inner.elts[-1]
    if not isinstance(inner, ast.Slice) or inner.step is not None:
        return None
    lower = 0 if inner.lower is None else constant(inner.lower)
    upper = None if inner.upper is None else constant(inner.upper)
    if isinstance(lower, int) and (upper is None or isinstance(upper, int)) and (inner.lower or inner.upper):
        return lower, upper
    return None


def _cut_values(function: Function) -> Iterator[tuple[ast.AST, str]]:
    """Yield joint values that are cut at a constant: read from a state, or put into an action."""
    for node in function.of(ast.Subscript):
        bounds = _bounds(node)
        if bounds is None or not isinstance(node.ctx, ast.Load):
            continue
        lower, upper = bounds
        if _names_joints(node.value) and upper is not None and upper - lower > 1:
            yield node, f"joint values are truncated to {upper - lower}: a robot with more joints loses the rest"
    for table in function.of(ast.Dict):
        for key, value in zip(table.keys, table.values, strict=True):
            if key is None or not _is_joint_key(key):
                continue
            cut = next((child for child in ast.walk(value) if _bounds(child) is not None), None)
            if cut is not None:
                yield (
                    cut,
                    f"{ast.unparse(key)} is a constant part of a vector: another robot gets its neighbour's values",
                )


def _names_joints(node: ast.expr) -> bool:
    """Tell whether an expression reads joint values of a state: `state["arm_joint_state"]`, with anything around it."""
    return any(isinstance(child, ast.Subscript) and _is_joint_key(child.slice) for child in ast.walk(node))


def _is_joint_key(key: ast.AST) -> bool:
    return isinstance(key, (ast.Constant, ast.JoinedStr)) and any(text.endswith(_STATE[0]) for text in texts(key))


def _layout(function: Function) -> Iterator[tuple[ast.AST, str]]:
    """Yield the first of three or more slices of one vector, in one statement, that are the layout of a robot."""
    if sum(_bounds(node) is not None for node in function.of(ast.Subscript)) < _FEWEST_CUTS:
        return
    for statement in function.of(ast.Assign, ast.Return, ast.Expr, ast.AnnAssign):
        cuts: dict[str, list[ast.Subscript]] = {}
        for node in ast.walk(statement):
            if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Load) and _bounds(node) is not None:
                cuts.setdefault(ast.unparse(node.value), []).append(node)
        for slices in cuts.values():
            edges = {edge for node in slices for edge in _bounds(node) or () if edge is not None}
            for name, bounds, length in _layouts():
                if len(slices) >= _FEWEST_CUTS and edges <= bounds and length in edges and len(edges) >= 4:
                    yield (
                        slices[0],
                        f"vectors are split as those of {name}: another robot's are refused, or mixed up",
                    )
                    break
