"""XPL164: The loop executes what the policy answered, unchanged and to its end."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.loops.functions import EXECUTES, chunks, does, loops
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last, names, targets

_HARMLESS: Final = frozenset(
    (
        sdk.Message.CALL,
        "copy",
        "deepcopy",
        "dict",
        "enumerate",
        "get",
        "items",
        "iter",
        "keys",
        "len",
        "list",
        "min",
        "range",
    )
) | {"tuple", "values", "zip"}


@rule(code="XPL164", requirement="XPL-LOOP-7")
def executed_otherwise(source: Source) -> Iterator[Finding]:
    """deploy.py executes something else than the policy answered.

    ## What it does
    Follows the answer of `get_action` to `take_action`. Reported are chunks that are cut at a number which stands in
    the code, and actions that are changed on the way: assigned to, computed with, or passed through a function.

    ## Why it matters
    Benchmarks and the audit run loops of their own, and a server answers other clients too: there the policy acts
    differently. A clipped gripper or a chunk cut to 8 belongs to the policy, where it is declared and measured.

    ## Example
    `for action in actions[:8]`, or `action["ee_joint_state"] = np.clip(action["ee_joint_state"], 0, 1)`.

    ## Use instead
    Cut and correct in `decode` of model.py, and declare `temporal.chunk` in policy.yml.

    ## Fix safety
    No automatic fix: what moves into model.py also acts elsewhere.
    """
    for function in loops(source):
        answered = chunks(function)
        if answered:
            yield from _cut(source, function, answered)
            yield from _edited(source, function, _single(function, answered), answered)


def _cut(source: Source, function: Function, answered: set[str]) -> Iterator[Finding]:
    """Yield places where a chunk is cut at a constant."""
    counters: set[str] = set()
    for node in (entry for entry in function.nodes if isinstance(entry, (ast.For, ast.If, ast.Subscript))):
        limit: object = ...
        is_counted = isinstance(node, ast.For) and called(node.iter) == "enumerate" and names(node.iter) & answered
        if isinstance(node, ast.For) and is_counted and isinstance(node.target, ast.Tuple):
            counters |= names(node.target.elts[0])
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice) and names(node.value) & answered:
            limit = constant(node.slice.upper)
        elif isinstance(node, ast.For) and called(node.iter) == "range" and isinstance(node.iter, ast.Call):
            is_chunk = any(
                isinstance(child, ast.Subscript)
                and names(child.value) & answered
                and names(child.slice) & names(node.target)
                for child in ast.walk(node)
            )
            limit = _smallest(node.iter.args[-1]) if is_chunk and node.iter.args else ...
        elif isinstance(node, ast.If) and isinstance(node.test, ast.Compare) and _leaves(node.body):
            is_counter = bool(names(node.test.left)) and names(node.test.left) <= counters
            limit = constant(node.test.comparators[0]) if is_counter else ...
        if isinstance(limit, int) and not isinstance(limit, bool):
            yield Finding(
                f"{function.name} executes {limit} actions of a chunk, however long: other loops execute all",
                **source.start(function.file, node),
                expected="every action of the chunk, or a shorter chunk from the policy",
                got=ast.unparse(node).splitlines()[0][:80],
                fix=Fix("advice", "cut the chunk in model.py, and declare its length in policy.yml"),
            )
            return


def _smallest(node: ast.AST) -> object:
    if called(node) == "min" and isinstance(node, ast.Call):
        return next((value for value in map(constant, node.args) if isinstance(value, int)), ...)
    return constant(node)


def _leaves(body: list[ast.stmt]) -> bool:
    return len(body) == 1 and isinstance(body[0], ast.Break)


def _single(function: Function, answered: set[str]) -> set[str]:
    """Return the names of single actions, and of lists of them."""
    passing = [
        (node, value, names(value))
        for node in function.nodes
        if isinstance(node, (ast.For, ast.Assign))
        for value in [node.iter if isinstance(node, ast.For) else node.value]
        if called(value) != "range"
    ]
    found: set[str] = set()
    for _ in range(3):  # through as many names
        for node, value, read in passing:
            if not read & (found | answered) or any(_computes(child) for child in ast.walk(value)):
                continue
            made = [target.id for target in targets(node) if isinstance(target, ast.Name)]
            is_part = any(isinstance(child, (ast.Subscript, ast.ListComp)) for child in ast.walk(value))
            if isinstance(node, ast.For) or is_part:
                found.update(made[called(value) == "enumerate" :])
    return found - answered


def _edited(source: Source, function: Function, single: set[str], answered: set[str]) -> Iterator[Finding]:
    """Yield the first place where an action is changed before it is executed."""
    followed = single | answered
    for node in function.nodes:
        if isinstance(node, (ast.Assign, ast.AugAssign)):
            for target in targets(node):
                into = isinstance(target, ast.Subscript) and _root(target) in followed
                again = isinstance(target, ast.Name) and target.id in single
                changes = isinstance(node, ast.AugAssign) or any(
                    _computes(child) and names(child) & followed for child in ast.walk(node.value)
                )
                if into or (again and changes):
                    yield _change(source, function, node)
                    return
    for call in does(function.node, function, EXECUTES):
        for child in ast.walk(call.args[0]) if call.args else ():
            if _computes(child) and names(child) & followed:
                yield _change(source, function, call)
                return


def _computes(node: ast.AST) -> bool:
    """Tell whether a node makes other values: arithmetic, or a call that is not known to hand on what it gets."""
    if isinstance(node, (ast.BinOp, ast.UnaryOp)):
        return not isinstance(node, ast.UnaryOp) or not isinstance(node.operand, ast.Constant)
    return isinstance(node, ast.Call) and last(called(node)) not in _HARMLESS


def _root(node: ast.AST) -> str:
    while isinstance(node, (ast.Subscript, ast.Attribute)):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def _change(source: Source, function: Function, node: ast.AST) -> Finding:
    return Finding(
        f"{function.name} executes other actions than the policy answered: every other client executes the original",
        **source.at(function.file, node),
        expected="the action as it came",
        got=ast.unparse(node)[:80],
        fix=Fix("advice", "move the change into decode of model.py"),
    )
