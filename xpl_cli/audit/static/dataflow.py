"""What a value of an adapter is made of, and what is made of a value, through local names and its own functions."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.syntax import dotted, names, parameters, targets

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from xpl_cli.audit.static.function import Function
    from xpl_cli.audit.static.model_class import ModelClass

_ARRAYS: Final = frozenset(("np", "numpy", "torch", "jnp", "math", "F"))
_BUILTINS: Final = frozenset(
    ("float", "int", "list", "tuple", "dict", "zip", "enumerate", "reversed", "max", "min", "abs")
)
_METHODS: Final = frozenset(
    (
        *(
            "astype",
            "reshape",
            "ravel",
            "flatten",
            "squeeze",
            "copy",
            "cpu",
            "numpy",
            "detach",
            "float",
            "double",
            "item",
        ),
        *("tolist", "clip", "clamp", "view", "unsqueeze", "to", "round", "items", "values", "mean"),
    )
)
_DEEPEST: Final = 4
"""Functions that are entered, one inside another."""


def sources_of(adapter: ModelClass, function: Function, value: ast.expr) -> list[ast.AST]:
    """Return the expressions that a value is made of: its own, those of local names in it, those of own functions.

    What another package computes, such as a model's answer, is not followed into its arguments.
    """
    found: list[ast.AST] = []
    _collect_sources(adapter, function, value, found, set(), 0)
    return found


def _collect_sources(  # noqa: PLR0913, PLR0917 - what a walk carries
    adapter: ModelClass,
    function: Function,
    value: ast.AST,
    found: list[ast.AST],
    seen: set[tuple[int, str]],
    depth: int,
) -> None:
    made = _assignments(function)
    for node in _parts(value, lambda call: adapter.callee(function, call) is None and not _is_array_call(call)):
        found.append(node)
        if isinstance(node, ast.Name) and (id(function.node), node.id) not in seen:
            seen.add((id(function.node), node.id))
            for assigned in made.get(node.id, ()):
                _collect_sources(adapter, function, assigned, found, seen, depth)
            if node.id in parameters(function.node) and depth < _DEEPEST:
                for caller, argument in _arguments(adapter, function, node.id):
                    _collect_sources(adapter, caller, argument, found, seen, depth + 1)
        elif isinstance(node, ast.Call) and depth < _DEEPEST:
            other = adapter.callee(function, node)
            if other is not None and (id(other.node), "") not in seen:
                seen.add((id(other.node), ""))
                for result in other.of(ast.Return):
                    if result.value is not None:
                        _collect_sources(adapter, other, result.value, found, seen, depth + 1)


def _arguments(adapter: ModelClass, function: Function, name: str) -> Iterator[tuple[Function, ast.expr]]:
    """Yield what the adapter's functions pass for a parameter of one of them, each with its caller."""
    for caller in adapter.reach(*adapter.methods):
        for call in caller.of(ast.Call):
            other = adapter.callee(caller, call)
            if other is not None and other.node is function.node:
                for parameter, argument in zip(parameters(function.node), call.args, strict=False):
                    if parameter == name:
                        yield caller, argument
                yield from ((caller, keyword.value) for keyword in call.keywords if keyword.arg == name)


def uses_of(adapter: ModelClass, function: Function, value: ast.expr) -> list[ast.AST]:
    """Return the expressions that a value stands in: its statement, those of names that hold it, in own functions."""
    found: list[ast.AST] = []
    _collect_uses(adapter, function, {id(value)}, set(), found, set(), 0)
    return found


def _collect_uses(  # noqa: PLR0913, PLR0917 - what a walk carries
    adapter: ModelClass,
    function: Function,
    marked: set[int],
    held: set[str],
    found: list[ast.AST],
    seen: set[tuple[int, str]],
    depth: int,
) -> None:
    before = -1
    statements = [node for node in function.nodes if isinstance(node, ast.stmt) and _is_simple(node)]
    touched: dict[int, ast.stmt] = {}
    while before != (before := len(held)):
        for statement in statements:
            inside = list(_parts(statement))
            if any(id(child) in marked or _is_held(child, held) for child in inside):
                touched[id(statement)] = statement
                for target in targets(statement):
                    held |= names(target) if isinstance(target, (ast.Name, ast.Tuple)) else set()
    for statement in touched.values():
        for node in _parts(statement):
            found.append(node)
            other = adapter.callee(function, node) if isinstance(node, ast.Call) and depth < _DEEPEST else None
            if other is None or not isinstance(node, ast.Call) or (id(other.node), "") in seen:
                continue
            given = {
                name
                for name, argument in zip(parameters(other.node), node.args, strict=False)
                if any(id(child) in marked or _is_held(child, held) for child in ast.walk(argument))
            }
            if given:
                seen.add((id(other.node), ""))
                _collect_uses(adapter, other, set(), given, found, seen, depth + 1)


def _parts(node: ast.AST, ends_at: Callable[[ast.Call], bool] = lambda _: False) -> Iterator[ast.AST]:
    """Yield a node and what is below it, without the places of subscripts, which are no values.

    Args:
        node: where to begin.
        ends_at: whether a call's arguments are left out.
    """
    waiting = [node]
    while waiting:
        one = waiting.pop()
        yield one
        if isinstance(one, ast.Subscript):
            waiting.append(one.value)
        elif not (isinstance(one, ast.Call) and ends_at(one)):
            waiting += ast.iter_child_nodes(one)


def _is_array_call(call: ast.Call) -> bool:
    """Tell whether a call works on arrays: a function of numpy or torch, a builtin, a method of a value."""
    root = dotted(call.func).partition(".")[0]
    if isinstance(call.func, ast.Name):
        return call.func.id in _BUILTINS
    return root in _ARRAYS or (
        root != "self" and call.func.attr in _METHODS if isinstance(call.func, ast.Attribute) else False
    )


def _is_simple(statement: ast.stmt) -> bool:
    return isinstance(statement, (ast.Assign, ast.AnnAssign, ast.AugAssign, ast.Return, ast.Expr))


def _is_held(node: ast.AST, held: set[str]) -> bool:
    return isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in held


def _assignments(function: Function) -> dict[str, list[ast.expr]]:
    made: dict[str, list[ast.expr]] = {}
    for name, value in _assigned(function):
        made.setdefault(name, []).append(value)
    return made


def _assigned(function: Function) -> Iterator[tuple[str, ast.expr]]:
    loops: list[ast.For | ast.comprehension] = [*function.of(ast.For), *function.of(ast.comprehension)]
    for loop in loops:
        yield from ((name, loop.iter) for name in names(loop.target))
    set_by: list[ast.Assign | ast.AnnAssign | ast.AugAssign] = [*function.of(ast.Assign), *function.of(ast.AnnAssign)]
    for node in [*set_by, *function.of(ast.AugAssign)]:
        for target in targets(node) if node.value is not None else ():
            if isinstance(target, (ast.Name, ast.Tuple)) and node.value is not None:
                yield from ((name, node.value) for name in names(target))
