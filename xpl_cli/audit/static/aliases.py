"""Which expressions share memory with something that is watched, and where it is changed through them.

The analysis reads a function from top to bottom, follows calls into the boundary, and believes the last assignment of a
name. It is told what is watched (an observation, a stored attribute) and yields the changes. Where it cannot tell
whether an operation copies, it takes it for a copy: what it reports is shared for certain, or as NumPy usually does it.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Literal

from xpl_cli.audit.static.syntax import SCOPES, called, constant, last, parameters, self_attribute

if TYPE_CHECKING:
    from xpl_cli.audit.static.adapter import Adapter
    from xpl_cli.audit.static.function import Function

_VIEW_METHODS: Final = frozenset(
    (
        *("reshape", "ravel", "squeeze", "unsqueeze", "transpose", "permute", "swapaxes", "view", "numpy", "detach"),
        "values",
    )
)
_VIEW_FUNCTIONS: Final = frozenset(
    (
        *("asarray", "asanyarray", "ascontiguousarray", "atleast_1d", "atleast_2d", "squeeze", "transpose", "moveaxis"),
        *("swapaxes", "expand_dims", "reshape", "ravel", "from_numpy", "as_tensor", "flip", "broadcast_to"),
    )
)
_CHANGING: Final = frozenset(
    (
        *("pop", "popitem", "update", "setdefault", "clear", "sort", "fill", "append", "extend", "insert", "remove"),
        *(
            "reverse",
            "mul_",
            "div_",
            "add_",
            "sub_",
            "clamp_",
            "clip_",
            "zero_",
            "fill_",
            "copy_",
            "normalize_",
            "resize",
        ),
    )
)
_DRAWING: Final = frozenset(("rectangle", "circle", "line", "putText", "polylines", "arrowedLine", "drawMarker"))
_FILLING: Final = frozenset(("copyto", "put", "place", "putmask", "fill_diagonal", "shuffle"))
_COMPREHENSIONS: Final = (ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp)
_INSIDE: Final = (ast.expr, ast.keyword, ast.withitem)
_SHALLOW: Final = frozenset(("dict", "list", "tuple", "sorted", "reversed", "copy"))

How = Literal["set", "augmented", "deleted", "called"]


@dataclass(frozen=True)
class Held:
    """What an expression shares with something watched.

    Attributes:
        root: what is watched, as a message names it.
        keys: constant keys on the way from there.
        is_copied: whether only its entries are shared, not the map or list itself.
    """

    root: str
    keys: tuple[str, ...] = ()
    is_copied: bool = False


@dataclass(frozen=True)
class Change:
    """One place where something watched is changed.

    Attributes:
        held: what is changed: the map whose entry is set, the array that is written to.
        key: the entry that is set or deleted, where it is constant.
        value: what is put there, for `set`.
    """

    function: Function
    node: ast.AST
    held: Held
    how: How
    key: str | None = None
    value: ast.expr | None = None
    before: Held | None = None


Scope = dict[str, Held]


@dataclass
class Sharing:
    """Follows watched values through an adapter.

    Args:
        adapter: whose functions are followed.
        attributes: attributes of `self` that are watched, or hold what is.
    """

    adapter: Adapter
    attributes: Mapping[str, Held] = field(default_factory=dict)
    changes: list[Change] = field(default_factory=list)
    _known: dict[tuple[int, frozenset[tuple[str, Held]]], Held | None] = field(default_factory=dict)

    def follow(self, function: Function, given: Scope) -> Held | None:
        """Read a function whose parameters share what `given` says; return what its result shares."""
        key = (id(function.node), frozenset(given.items()))
        if key not in self._known and len(self._known) < 400:
            self._known[key] = None
            if given or self._mentions(function):
                self._known[key] = _Reading(self, function).run(given)
            else:  # nothing watched here: only what it calls may matter
                for call in function.of(ast.Call):
                    if (other := self.adapter.callee(function, call)) is not None:
                        self.follow(other, {})
        return self._known.get(key)

    def _mentions(self, function: Function) -> bool:
        return any(node.attr in self.attributes and self_attribute(node) for node in function.of(ast.Attribute))


class _Reading:
    """One reading of one function."""

    def __init__(self, sharing: Sharing, function: Function) -> None:
        self.sharing = sharing
        self.function = function
        self.returned: Held | None = None

    def run(self, given: Scope) -> Held | None:
        self.block(self.function.node.body, dict(given))
        return self.returned

    def block(self, body: list[ast.stmt], scope: Scope) -> None:
        for statement in body:
            if not isinstance(statement, SCOPES):
                getattr(self, f"_{type(statement).__name__.lower()}", self._other)(statement, scope)

    # -- statements ----------------------------------------------------------------------------------------------------

    def _other(self, node: ast.stmt, scope: Scope) -> None:
        self.calls(node, scope)
        for block in ("body", "orelse", "finalbody"):
            self.block(getattr(node, block, []), scope)
        for handler in getattr(node, "handlers", []):
            self.block(handler.body, scope)

    def _assign(self, node: ast.Assign, scope: Scope) -> None:
        self.calls(node, scope)
        for target in node.targets:
            self.bind(target, node.value, scope, node)

    def _annassign(self, node: ast.AnnAssign, scope: Scope) -> None:
        if node.value is not None:
            self.calls(node, scope)
            self.bind(node.target, node.value, scope, node)

    def _augassign(self, node: ast.AugAssign, scope: Scope) -> None:
        self.calls(node, scope)
        held = self.value(node.target, scope)
        if held is not None and not held.is_copied and isinstance(node.target, (ast.Name, ast.Subscript)):
            self.note(node, held, "augmented")

    def _delete(self, node: ast.Delete, scope: Scope) -> None:
        for target in node.targets:
            held = self.value(target.value, scope) if isinstance(target, ast.Subscript) else None
            if held is not None and not held.is_copied and isinstance(target, ast.Subscript):
                self.note(node, held, "deleted", key=_key(target))

    def _for(self, node: ast.For, scope: Scope) -> None:
        self.calls(node.iter, scope)
        self.bind_element(node.target, node.iter, scope)
        self.block([*node.body, *node.orelse], scope)

    def _if(self, node: ast.If, scope: Scope) -> None:
        self.calls(node.test, scope)
        branches: list[Scope] = []
        for body in (node.body, node.orelse):
            branch = dict(scope)
            self.block(body, branch)
            if not body or not isinstance(body[-1], (ast.Return, ast.Raise, ast.Continue, ast.Break)):
                branches.append(branch)
        scope.clear()
        for branch in branches:
            for name, held in branch.items():
                if name not in scope or scope[name].is_copied:
                    scope[name] = held

    def _return(self, node: ast.Return, scope: Scope) -> None:
        if node.value is not None:
            self.calls(node.value, scope)
            self.returned = self.value(node.value, scope) or self.returned

    # -- names ---------------------------------------------------------------------------------------------------------

    def bind(self, target: ast.expr, value: ast.expr, scope: Scope, node: ast.stmt) -> None:
        if isinstance(target, ast.Name):
            _set(scope, target.id, self.value(value, scope))
        elif isinstance(target, (ast.Tuple, ast.List)):
            values = value.elts if isinstance(value, (ast.Tuple, ast.List)) else []
            for place, entry in enumerate(target.elts):
                if len(values) == len(target.elts):
                    self.bind(entry, values[place], scope, node)
                elif isinstance(entry, ast.Name):
                    scope.pop(entry.id, None)
        elif isinstance(target, ast.Subscript):
            held = self.value(target.value, scope)
            if held is not None and not held.is_copied:
                self.note(node, held, "set", key=_key(target), value=value, before=self.value(value, scope))

    def bind_element(self, target: ast.expr, iterated: ast.expr, scope: Scope) -> None:
        """Bind the variable of a loop to what an entry shares."""
        name = last(called(iterated))
        arguments = iterated.args if isinstance(iterated, ast.Call) else []
        parts = target.elts if isinstance(target, (ast.Tuple, ast.List)) else []
        if name == "enumerate" and len(parts) == 2 and arguments:
            self.bind_element(parts[1], arguments[0], scope)
        elif name == "zip" and len(parts) == len(arguments):
            for part, argument in zip(parts, arguments, strict=True):
                self.bind_element(part, argument, scope)
        elif name == "items" and len(parts) == 2 and isinstance(iterated, ast.Call):
            owner = iterated.func.value if isinstance(iterated.func, ast.Attribute) else iterated
            self.bind_element(parts[1], owner, scope)
        elif isinstance(target, ast.Name):
            held = self.value(iterated, scope)
            _set(scope, target.id, None if held is None else replace(held, is_copied=False))

    # -- expressions ---------------------------------------------------------------------------------------------------

    def calls(self, node: ast.AST, scope: Scope) -> None:
        """Look at every call in a statement or expression, without entering its blocks."""
        if not scope and not self.sharing.attributes:
            return
        for child in _expressions(node):
            if isinstance(child, ast.Call):
                self.call(child, scope)
            elif isinstance(child, _COMPREHENSIONS):
                inner = dict(scope)
                for generator in child.generators:
                    self.bind_element(generator.target, generator.iter, inner)
                for part in (child.key, child.value) if isinstance(child, ast.DictComp) else (child.elt,):
                    self.calls(part, inner)

    def call(self, node: ast.Call, scope: Scope) -> Held | None:
        """Note what a call changes, follow it into the boundary, and return what its result shares."""
        name = last(called(node))
        arguments = [self.value(argument, scope) for argument in node.args]
        receiver = self.value(node.func.value, scope) if isinstance(node.func, ast.Attribute) else None
        if receiver is not None and not receiver.is_copied and name in _CHANGING:
            key = constant(node.args[0]) if node.args and name in {"pop", "setdefault"} else None
            self.note(node, receiver, "called", key=key if isinstance(key, str) else None)
        elif name in _DRAWING | _FILLING and arguments and (first := arguments[0]) is not None and not first.is_copied:
            self.note(node, first, "called")
        for keyword in node.keywords:
            out = self.value(keyword.value, scope) if keyword.arg in {"out", "dst"} else None
            if out is not None and not out.is_copied:
                self.note(node, out, "called")
        other = self.sharing.adapter.callee(self.function, node)
        if other is None:
            return None
        given = dict(zip(parameters(other.node), arguments, strict=False))
        given |= {keyword.arg: self.value(keyword.value, scope) for keyword in node.keywords if keyword.arg}
        shared = {name: held for name, held in given.items() if held is not None}
        return self.sharing.follow(other, shared) if shared or self.sharing.attributes else None

    def value(self, node: ast.expr, scope: Scope) -> Held | None:
        """Return what an expression shares with something watched."""
        found: Held | None = None
        match node:
            case ast.Name(id=name):
                found = scope.get(name)
            case ast.Attribute(value=ast.Name(id="self"), attr=name):
                found = self.sharing.attributes.get(name)
            case ast.Attribute(value=owner, attr="T" | "data"):
                found = self.value(owner, scope)
            case ast.Subscript(value=owner, slice=key):
                found = _entry(self.value(owner, scope), key)
            case ast.Call():
                found = self._result(node, scope)
            case ast.IfExp(body=first, orelse=second):
                found = self.value(first, scope) or self.value(second, scope)
            case ast.BoolOp(values=values):
                found = next(filter(None, (self.value(value, scope) for value in values)), None)
            case ast.Dict(keys=keys, values=values) if None in keys:
                found = _copied(self.value(values[keys.index(None)], scope))
        return found

    def _result(self, node: ast.Call, scope: Scope) -> Held | None:
        name = last(called(node))
        receiver = self.value(node.func.value, scope) if isinstance(node.func, ast.Attribute) else None
        if receiver is not None:
            return _of_method(receiver, name, node)
        if self.sharing.adapter.callee(self.function, node) is not None:
            return self.call(node, scope)
        first = self.value(node.args[0], scope) if node.args else None
        if name in _SHALLOW:
            return _copied(first)
        # With a type, an array is copied or not as it happens to come: only a call without one is certain.
        is_view = name in _VIEW_FUNCTIONS and not any(entry.arg == "dtype" for entry in node.keywords)
        may_convert = name in {"asarray", "asanyarray", "ascontiguousarray", "as_tensor"} and len(node.args) > 1
        return first if is_view and not may_convert and first is not None and not first.is_copied else None

    def note(self, node: ast.AST, held: Held, how: How, **told: object) -> None:
        change = Change(self.function, node, held, how, **told)  # type: ignore[arg-type]
        if change not in self.sharing.changes:
            self.sharing.changes.append(change)


def stored(functions: list[Function]) -> dict[str, Held]:
    """Return the attributes that these functions fill, each watched under its own name."""
    return {write.attribute: Held(f"self.{write.attribute}") for function in functions for write in function.writes}


def _of_method(held: Held, name: str, node: ast.Call) -> Held | None:
    """Return what the result of a method of something shared shares."""
    if name in {"get", "pop", "setdefault"} and node.args:
        return _entry(held, node.args[0])
    if name == "copy":
        return _copied(held)
    return held if name in _VIEW_METHODS else None


def _copied(held: Held | None) -> Held | None:
    return None if held is None else replace(held, is_copied=True)


def _entry(held: Held | None, key: ast.expr) -> Held | None:
    """Return what an entry of something shared shares: of a map always, of an array where a slice is a view."""
    if held is None:
        return None
    name = constant(key)
    if isinstance(name, str):
        return Held(held.root, (*held.keys, name))
    if held.is_copied or isinstance(key, (ast.List, ast.Compare)):
        return None
    return held


def _key(node: ast.Subscript) -> str | None:
    key = constant(node.slice)
    return key if isinstance(key, str) else None


def _set(scope: Scope, name: str, held: Held | None) -> None:
    if held is None:
        scope.pop(name, None)
    else:
        scope[name] = held


def _expressions(node: ast.AST) -> list[ast.expr]:
    """Return the calls and comprehensions of a statement; its blocks and what comprehensions repeat are left out."""
    found: list[ast.expr] = []
    todo = [node]
    while todo:
        child = todo.pop()
        if isinstance(child, _COMPREHENSIONS):
            found.append(child)
            todo.extend(generator.iter for generator in child.generators)
            continue
        if isinstance(child, ast.Call):
            found.append(child)
        for name in child._fields:
            value = getattr(child, name)
            if isinstance(value, list):
                todo.extend(entry for entry in value if isinstance(entry, _INSIDE))
            elif isinstance(value, _INSIDE):
                todo.append(value)
    return found
