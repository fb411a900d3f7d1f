"""Whether an adapter passes whole observations to other packages, which may read any key of them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.function import GROWING
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass, origin
from xpl_cli.audit.static.syntax import called, constant, last, names, parameters, self_attribute, targets

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function

_KNOWN: Final = frozenset(
    (
        *("dict", "list", "tuple", "copy", "deepcopy", "enumerate", "zip", "len", "isinstance", "print", "str", "bool"),
        *("type", "id", "repr", "sorted", "reversed", "get", "setdefault", "RuntimeError", "ValueError", "KeyError"),
        *GROWING,
    )
)
"""Calls that read no key of an observation, or only a named one."""
_COPIES: Final = frozenset(("dict", "list", "copy", "deepcopy", "enumerate", "zip", "values", "items"))
_READ: Final = ("XPolicyLab.", "xpl.")
"""Packages whose helpers read observations, but not the instruction."""


def escapes(adapter: ModelClass) -> bool:
    """Return whether an observation, or an entry of a stored batch, is passed to a function outside of the boundary."""
    functions, trail = _followed(adapter)
    return any(trail.leaves(function, call) for function in functions for call in function.of(ast.Call))


def required_keys(adapter: ModelClass) -> Iterator[tuple[Function, ast.Subscript, str]]:
    """Yield the look-ups `observation["key"]` of a whole observation, and their keys.

    A name that also holds something else, such as what an encoder returned, is left out.
    """
    functions, trail = _followed(adapter)
    for function in functions:
        local, mixed = trail.local[id(function.node)], _mixed(function, trail)
        for node in function.of(ast.Subscript):
            key = constant(node.slice)
            if not isinstance(key, str) or not isinstance(node.ctx, ast.Load) or names(node.value) & mixed:
                continue
            if _is_whole(node.value, local, trail.stored):
                yield function, node, key


def _followed(adapter: ModelClass) -> tuple[list[Function], _ObservationFlow]:
    """Return the functions that observations may reach, and where they are in these."""
    functions = {id(function.node): function for function in adapter.reach(*OBSERVING, *ACTING)}
    trail = _ObservationFlow(adapter, {key: set() for key in functions})
    for name in OBSERVING:
        function = adapter.method(name)
        if function is not None:
            trail.local[id(function.node)].update(parameters(function.node)[:1])
    before = -1
    while before != (before := len(trail.stored) + sum(map(len, trail.local.values()))):
        for function in functions.values():
            trail.propagate(function)
    return list(functions.values()), trail


def _mixed(function: Function, trail: _ObservationFlow) -> set[str]:
    """Return the names to which a function also assigns something else than an observation."""
    local = trail.local[id(function.node)]
    set_by: list[tuple[ast.AST, ast.expr]] = [(node, node.value) for node in function.of(ast.Assign)]
    set_by += [(node, node.value) for node in function.of(ast.AnnAssign) if node.value is not None]
    set_by += [(node, node.iter) for node in function.of(ast.For)]
    return {
        target.id
        for node, value in set_by
        if not _holds(value, local, trail.stored)
        for target in targets(node)
        if isinstance(target, ast.Name)
    }


@dataclass
class _ObservationFlow:
    """Names and attributes that hold observations.

    Attributes:
        local: names, by function.
        stored: attributes.
    """

    adapter: ModelClass
    local: dict[int, set[str]]
    stored: set[str] = field(default_factory=set)

    def propagate(self, function: Function) -> None:
        """Add the names, attributes and parameters to which a function assigns observations."""
        local = self.local[id(function.node)]
        settings: list[ast.Assign | ast.AnnAssign] = [*function.of(ast.Assign), *function.of(ast.AnnAssign)]
        for node in settings:
            if node.value is not None and _holds(node.value, local, self.stored):
                for target in targets(node):
                    attribute = self_attribute(target)
                    if isinstance(target, ast.Name):
                        local.add(target.id)
                    elif attribute is not None:
                        self.stored.add(attribute)
        loops: list[ast.For | ast.comprehension] = [*function.of(ast.For), *function.of(ast.comprehension)]
        for loop in loops:
            if _holds(loop.iter, local, self.stored):
                local |= names(loop.target)
        for call in function.of(ast.Call):
            self._propagate_call(function, call, local)

    def _propagate_call(self, function: Function, call: ast.Call, local: set[str]) -> None:
        """Add attributes and parameters of the boundary that get an observation by a call."""
        if isinstance(call.func, ast.Attribute) and call.func.attr in GROWING:
            attribute = self_attribute(call.func.value)
            if attribute is not None and any(_is_whole(value, local, self.stored) for value in call.args):
                self.stored.add(attribute)
        other = self.adapter.callee(function, call)
        if other is not None:
            arguments = list(zip(parameters(other.node), call.args, strict=False))
            arguments += [(keyword.arg, keyword.value) for keyword in call.keywords if keyword.arg]
            observed_names = self.local.setdefault(id(other.node), set())
            observed_names |= {name for name, value in arguments if _is_whole(value, local, self.stored)}

    def leaves(self, function: Function, call: ast.Call) -> bool:
        """Return whether a call passes an observation to code of another package."""
        name, local = called(call), self.local[id(function.node)]
        if last(name) in _KNOWN or self.adapter.callee(function, call) is not None:
            return False
        arguments = (*call.args, *(keyword.value for keyword in call.keywords))
        if not any(_is_whole(value, local, self.stored) for value in arguments):
            return False
        return not f"{origin(self.adapter.source, function.file, name)}.".startswith(_READ)


def _holds(node: ast.expr, local: set[str], stored: set[str]) -> bool:
    """Return whether an expression is an observation, a copy of one, or a container of some."""
    return any(_is_whole(value, local, stored) for value in _within(node))


def _within(node: ast.expr) -> list[ast.expr]:
    """Return the elements of a container, or the original of a copy; else the expression itself."""
    parts: list[ast.expr] = [node]
    if isinstance(node, (ast.ListComp, ast.GeneratorExp)):
        parts = [node.elt]
    elif isinstance(node, ast.DictComp):
        parts = [node.value]
    elif isinstance(node, ast.Dict):
        parts = [value for key, value in zip(node.keys, node.values, strict=True) if key is None]
    elif isinstance(node, (ast.List, ast.Tuple)):
        parts = list(node.elts)
    elif isinstance(node, ast.Call) and last(called(node)) in _COPIES:
        parts = [*node.args, *([node.func.value] if isinstance(node.func, ast.Attribute) else [])]
    return parts


def _is_whole(node: ast.expr, local: set[str], stored: set[str]) -> bool:
    """Return whether an expression is an observation itself, or an entry of a container of some."""
    if isinstance(node, ast.Subscript):
        return not isinstance(constant(node.slice), str) and _is_whole(node.value, local, stored)
    if isinstance(node, ast.Name):
        return node.id in local
    return isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and self_attribute(node) in stored
