"""What a value of an adapter is made of, and what is made of a value, through local names and its own functions."""

from __future__ import annotations

import ast
import functools
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.syntax import dotted, names, parameters, self_attribute, targets

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
    for node in _parts(value, functools.partial(_is_foreign, adapter, function)):
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


def everywhere_after(adapter: ModelClass, values: list[ast.expr]) -> list[ast.AST]:
    """Return all expressions of statements that values may reach: through names, attributes, calls and returns.

    More than the values may be meant, for example other entries of a map that holds one of them.
    """
    reach = _Reach(adapter, {id(value) for value in values})
    before = -1
    while before != (before := reach.size()):
        for function in adapter.reach(*adapter.methods):
            reach.propagate(function)
    return [node for statement in reach.statements.values() for node in _parts(statement)]


@dataclass
class _Reach:
    """Where values may be.

    Attributes:
        marked: ids of the expressions that are the values.
        held: local names, by function.
        attributes: of `self`.
        returning: ids of the functions that return one.
        statements: those that have one in them, by their ids.
    """

    adapter: ModelClass
    marked: set[int]
    held: dict[int, set[str]] = field(default_factory=dict)
    attributes: set[str] = field(default_factory=set)
    returning: set[int] = field(default_factory=set)
    statements: dict[int, ast.stmt] = field(default_factory=dict)

    def size(self) -> int:
        """Return how much is reached, which only grows."""
        names_held = sum(map(len, self.held.values()))
        return names_held + len(self.attributes) + len(self.returning) + len(self.statements)

    def propagate(self, function: Function) -> None:
        """Add what the statements of a function that hold a value assign, pass on and return."""
        local = self.held.setdefault(id(function.node), set())
        for statement in (node for node in function.nodes if isinstance(node, ast.stmt) and _is_simple(node)):
            if self._is_in(function, statement):
                self.statements[id(statement)] = statement
                if self._is_in(function, statement, of_model=False):
                    self._assign(function, statement)
                for call in (node for node in _parts(statement) if isinstance(node, ast.Call)):
                    self._pass_on(function, call)
        loops: list[ast.For | ast.comprehension] = [*function.of(ast.For), *function.of(ast.comprehension)]
        for loop in loops:
            local |= names(loop.target) if self._is_in(function, loop.iter, of_model=False) else set()

    def _assign(self, function: Function, statement: ast.stmt) -> None:
        if isinstance(statement, ast.Return):
            self.returning.add(id(function.node))
        for target in targets(statement):
            attribute = self_attribute(target)
            if attribute is not None:
                self.attributes.add(attribute)
            else:
                self.held[id(function.node)] |= names(target)

    def _pass_on(self, function: Function, call: ast.Call) -> None:
        other = self.adapter.callee(function, call)
        if other is not None:
            given = zip(parameters(other.node), call.args, strict=False)
            reached = {name for name, argument in given if self._is_in(function, argument)}
            self.held.setdefault(id(other.node), set()).update(reached)

    def _is_in(self, function: Function, node: ast.AST, *, of_model: bool = True) -> bool:
        """Return whether a value is in an expression; `of_model`: also as an argument of another package's function."""
        ends = functools.partial(_is_foreign, self.adapter, function)
        return any(self._is_one(function, part) for part in (_parts(node) if of_model else _parts(node, ends)))

    def _is_one(self, function: Function, node: ast.AST) -> bool:
        if id(node) in self.marked or _is_held(node, self.held[id(function.node)]):
            return True
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            return self_attribute(node) in self.attributes
        other = self.adapter.callee(function, node) if isinstance(node, ast.Call) else None
        return other is not None and id(other.node) in self.returning


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


def _is_foreign(adapter: ModelClass, function: Function, call: ast.Call) -> bool:
    """Tell whether a call is one of another package, whose result is its own, such as a model's answer."""
    return adapter.callee(function, call) is None and not _is_array_call(call)


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


def _bound(target: ast.expr, iterated: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    """Yield the names of a loop with what each goes through: of `zip` and `enumerate` its own part."""
    called_name = dotted(iterated.func) if isinstance(iterated, ast.Call) else ""
    parts = iterated.args if isinstance(iterated, ast.Call) else []
    if isinstance(target, ast.Tuple) and called_name == "zip" and len(parts) == len(target.elts):
        for one, part in zip(target.elts, parts, strict=True):
            yield from ((name, part) for name in names(one))
    elif isinstance(target, ast.Tuple) and called_name == "enumerate" and len(target.elts) == 2 and parts:
        yield from _bound(target.elts[1], parts[0])
    else:
        yield from ((name, iterated) for name in names(target))


def _assigned(function: Function) -> Iterator[tuple[str, ast.expr]]:
    loops: list[ast.For | ast.comprehension] = [*function.of(ast.For), *function.of(ast.comprehension)]
    for loop in loops:
        yield from _bound(loop.target, loop.iter)
    set_by: list[ast.Assign | ast.AnnAssign | ast.AugAssign] = [*function.of(ast.Assign), *function.of(ast.AnnAssign)]
    for node in [*set_by, *function.of(ast.AugAssign)]:
        for target in targets(node) if node.value is not None else ():
            if isinstance(target, (ast.Name, ast.Tuple)) and node.value is not None:
                yield from ((name, node.value) for name in names(target))
