"""Expressions and calls of an evaluation loop, followed on its syntax tree (see `follow`)."""

from __future__ import annotations

import ast
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.audit.static.loops.values import Choices, Unclear, binary, built_in, entries, item, method, small, store
from xpl_cli.audit.static.loops.world import OPERATIONS, Kind, Opaque, Token, World, changed

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function
    from xpl_cli.audit.static.syntax import FunctionNode

Resolve = Callable[[str, str], "Function | ast.expr | None"]
"""What a name means in a file: a function of the adapter, the expression of a constant, or nothing that is known."""

STEPS: Final = 60_000
"""Nodes that are followed before it gives up."""
_ENTRIES: Final = 16
"""Entries of a list that are as much work as a node."""
ENVIRONMENT, CLIENT = object(), object()
"""What an evaluation function is given."""

_ASKS: Final = frozenset(("isinstance", "hasattr", "getattr", "print", "type"))
_KINDS: Final[dict[str, tuple[type, ...]]] = {
    "list": (list,),
    "tuple": (tuple,),
    "dict": (dict, Token),
    "set": (set,),
    "int": (int,),
    "str": (str,),
}


@dataclass(frozen=True)
class Defined:
    """A function or lambda of the adapter."""

    file: str
    node: FunctionNode | ast.Lambda
    outer: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Bound:
    """A method of the environment, of the client, or of a value."""

    owner: Any
    name: str


class Reader(ABC):
    """Follows expressions.

    Args:
        world: what the environment and the client stand for.
        resolve: what names of files mean.
        choices: what opaque conditions are taken for.

    Attributes:
        file, scope: where it is, and what the local names there stand for.
    """

    def __init__(self, world: World, resolve: Resolve, choices: Choices) -> None:
        self.world, self.resolve, self.choices = world, resolve, choices
        self.file = ""
        self.scope: dict[str, Any] = {}
        self._left = STEPS
        self._expressions: Mapping[type[ast.expr], Callable[[Any], Any]] = {
            ast.Constant: lambda node: node.value,
            ast.Name: lambda node: self._name(node.id),
            ast.Attribute: self._attribute,
            ast.Subscript: lambda node: item(self.value(node.value), self.key(node.slice)),
            ast.Call: self._call,
            ast.BinOp: lambda node: binary(node.op, self.value(node.left), self.value(node.right)),
            ast.BoolOp: self._either,
            ast.UnaryOp: self._unary,
            ast.Compare: self._compare,
            ast.IfExp: lambda node: self.value(node.body if self.holds(node.test) else node.orelse),
            ast.List: lambda node: self._all(node.elts),
            ast.Tuple: lambda node: tuple(self._all(node.elts)),
            ast.Set: lambda node: set(self._all(node.elts)),
            ast.Dict: self._dict,
            ast.ListComp: lambda node: self._comprehended(node, [node.elt]),
            ast.GeneratorExp: lambda node: self._comprehended(node, [node.elt]),
            ast.SetComp: lambda node: set(self._comprehended(node, [node.elt])),
            ast.DictComp: lambda node: dict(self._comprehended(node, [node.key, node.value])),
            ast.NamedExpr: self._walrus,
            ast.Lambda: lambda node: Defined(self.file, node, self.scope),
            ast.JoinedStr: lambda _: Opaque(),
        }

    @abstractmethod
    def body(self, body: Sequence[ast.stmt]) -> Any:
        """Follow the body of a function and return what it returns."""

    def call(self, function: Defined, given: Sequence[Any], named: Mapping[str, Any]) -> Any:
        """Follow a function of the adapter and return what it returns."""
        node, arguments = function.node, function.node.args
        before = self.file, self.scope
        names = [argument.arg for argument in (*arguments.posonlyargs, *arguments.args)]
        defaults = dict(zip(names[len(names) - len(arguments.defaults) :], arguments.defaults, strict=True))
        defaults |= {
            argument.arg: value
            for argument, value in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
            if value is not None
        }
        self.file, self.scope = function.file, dict(function.outer)
        try:
            self.scope.update({name: self.value(value) for name, value in defaults.items()})
            self.scope.update(zip(names, given, strict=False))
            self.scope.update(named)
            if isinstance(node, ast.Lambda):
                return self.value(node.body)
            return self.body(node.body)
        finally:
            self.file, self.scope = before

    def store(self, target: ast.expr, value: Any) -> None:
        """Put a value where an assignment puts it."""
        if isinstance(target, ast.Name):
            self.scope[target.id] = value
        elif isinstance(target, (ast.Tuple, ast.List)):
            values = entries(value)
            for place, entry in enumerate(target.elts):
                inner = entry.value if isinstance(entry, ast.Starred) else entry
                known = values is not None and not isinstance(entry, ast.Starred) and place < len(values)
                self.store(inner, values[place] if known and values is not None else changed(value))
        elif isinstance(target, ast.Subscript):
            store(self.value(target.value), self.key(target.slice), value)

    def value(self, node: ast.expr) -> Any:
        """Return what an expression stands for."""
        self.count()
        handler = self._expressions.get(type(node))
        if handler is None:
            if isinstance(node, (ast.Yield, ast.YieldFrom, ast.Await)):
                raise Unclear(f"line {node.lineno} waits for others")
            return Opaque()
        found = handler(node)
        if isinstance(found, list):
            self.count(len(found) // _ENTRIES)
        return found

    def count(self, work: int = 1) -> None:
        """Note that one more node is followed, or as much work as this.

        Raises:
            Unclear: if it is too much.
        """
        self._left -= work
        if self._left < 0:
            raise Unclear("it does not come to an end")

    def _all(self, nodes: Sequence[ast.expr]) -> list[Any]:
        found: list[Any] = []
        for node in nodes:
            if isinstance(node, ast.Starred):
                found.extend(entries(self.value(node.value)) or ())
            else:
                found.append(self.value(node))
        return found

    def holds(self, node: ast.expr) -> bool:
        """Return whether a condition holds, or is taken to hold."""
        value = self.value(node)
        if isinstance(value, Opaque) and not isinstance(value, Token):
            return self.choices.of(node)
        return bool(value)

    def _name(self, name: str) -> Any:
        if name in self.scope:
            return self.scope[name]
        found = self.resolve(self.file, name)
        if isinstance(found, ast.expr):
            return self.value(found)
        if found is not None:
            return Defined(found.file, found.node)
        return built_in(name) or Opaque()

    def _attribute(self, node: ast.Attribute) -> Any:
        owner = self.value(node.value)
        if owner is ENVIRONMENT and node.attr not in OPERATIONS:
            self.world.place = (self.file, node)
            self.world.note(Kind.ENVIRONMENT, node.attr)
            return Opaque()
        return _Bound(owner, node.attr)

    def key(self, node: ast.expr) -> Any:
        """Return what stands in the brackets of a subscript."""
        if not isinstance(node, ast.Slice):
            return self.value(node)
        bounds = [None if one is None else self.value(one) for one in (node.lower, node.upper, node.step)]
        return Opaque() if any(isinstance(one, Opaque) for one in bounds) else slice(*bounds)

    def _either(self, node: ast.BoolOp) -> Any:
        stops = isinstance(node.op, ast.Or)
        value: Any = None
        for part in node.values:
            value = self.value(part)
            known = self.choices.of(part) if type(value) is Opaque else bool(value)
            if known is stops:
                return known if type(value) is Opaque else value
        return (not stops) if type(value) is Opaque else value

    def _unary(self, node: ast.UnaryOp) -> Any:
        if isinstance(node.op, ast.Not):
            return not self.holds(node.operand)
        value = self.value(node.operand)
        is_number = isinstance(value, (int, float)) and isinstance(node.op, ast.USub)
        return -value if is_number else changed(value)

    def _compare(self, node: ast.Compare) -> Any:
        left = self.value(node.left)
        for sign, part in zip(node.ops, node.comparators, strict=True):
            right = self.value(part)
            value = binary(sign, left, right)
            if isinstance(value, Opaque):
                return Opaque()
            if not value:
                return False
            left = right
        return True

    def _dict(self, node: ast.Dict) -> Any:
        merged: dict[Any, Any] = {}
        token: Token | None = None
        for key, value in zip(node.keys, node.values, strict=True):
            found = self.value(value)
            if key is None and isinstance(found, Token):
                token = found
            elif key is None and isinstance(found, dict):
                merged.update(found)
            elif key is not None and not isinstance(place := self.value(key), (Opaque, list, dict, set)):
                merged[place] = found
        return merged if token is None else token.copy(changed=len(node.keys) > 1)

    def _comprehended(
        self, node: ast.ListComp | ast.SetComp | ast.GeneratorExp | ast.DictComp, parts: list[ast.expr]
    ) -> list[Any]:
        found: list[Any] = []
        before, self.scope = self.scope, dict(self.scope)
        try:
            self._generate(node.generators, parts, found)
        finally:
            self.scope = before
        result: list[Any] = small(found)
        return result

    def _generate(self, generators: Sequence[ast.comprehension], parts: list[ast.expr], found: list[Any]) -> None:
        if not generators:
            made = [self.value(part) for part in parts]
            found.append(made[0] if len(made) == 1 else tuple(made))
            return
        first, *rest = generators
        through = self.value(first.iter)
        for value in entries(through) or ():
            self.store(first.target, value)
            if all(self.holds(test) for test in first.ifs):
                self._generate(rest, parts, found)

    def _walrus(self, node: ast.NamedExpr) -> Any:
        self.scope[node.target.id] = value = self.value(node.value)
        return value

    def _call(self, node: ast.Call) -> Any:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name in _ASKS:
            return self._asked(name, node)
        function = self.value(node.func)
        given = self._all(node.args)
        named = {keyword.arg: self.value(keyword.value) for keyword in node.keywords if keyword.arg is not None}
        self.world.place = (self.file, node)
        if isinstance(function, Defined):
            return self.call(function, given, named)
        if isinstance(function, _Bound):
            return self._bound(function, given, named, node)
        handed = [*given, *named.values()]
        if callable(function):
            if any(isinstance(value, Defined) for value in handed):
                given = [self._callable(value) for value in given]
                named = {key: self._callable(value) for key, value in named.items()}
            return function(*given, **named)
        if any(value is ENVIRONMENT or value is CLIENT for value in handed):
            raise Unclear(
                f"line {node.lineno} hands the environment or the client to a function outside of the adapter"
            )
        return changed(next((value for value in handed if type(changed(value)) is not Opaque), Opaque()))

    def _bound(self, function: _Bound, given: list[Any], named: dict[str, Any], node: ast.Call) -> Any:
        owner, name = function.owner, function.name
        if owner is ENVIRONMENT:
            try:
                return getattr(self.world, name)(*given, **named)
            except TypeError:
                raise Unclear(
                    f"line {node.lineno} calls the environment with arguments that it does not take"
                ) from None
        if owner is CLIENT:
            return self._ask(name, given, named)
        if any(value is ENVIRONMENT or value is CLIENT for value in (*given, *named.values())):
            raise Unclear(
                f"line {node.lineno} hands the environment or the client to a function outside of the adapter"
            )
        if isinstance(owner, Opaque) and owner.root is None:  # a module, or an object of one
            return self._foreign(name, given, named)
        return method(owner, name, given, named)

    def _foreign(self, name: str, given: list[Any], named: dict[str, Any]) -> Any:
        known = built_in(name)
        if known is not None and given:
            return known(*given)
        handed = [*given, *named.values()]
        return changed(next((value for value in handed if type(changed(value)) is not Opaque), Opaque()))

    def _ask(self, name: str, given: list[Any], named: dict[str, Any]) -> Any:
        values = dict(zip((sdk.Payload.FUNC_NAME, sdk.Payload.OBS)[name != sdk.Message.CALL :], given, strict=False))
        values.update(named)
        operation = values.get(sdk.Payload.FUNC_NAME) if name == sdk.Message.CALL else name
        if isinstance(operation, Opaque):
            raise Unclear("it asks the policy for an operation whose name is made at run time")
        shown = values.get(
            sdk.Payload.OBS, next((value for key, value in values.items() if key != sdk.Payload.FUNC_NAME), None)
        )
        return self.world.asked(str(operation), shown)

    def _callable(self, value: Any) -> Any:
        if not isinstance(value, Defined):
            return value
        return lambda *given, **named: self.call(value, given, named)

    def _asked(self, name: str, node: ast.Call) -> Any:
        """Follow `isinstance`, `hasattr`, `getattr`, `print`: questions are no use of the environment."""
        values = self._all(node.args)
        if name == "isinstance" and len(node.args) == 2:
            kinds = node.args[1].elts if isinstance(node.args[1], ast.Tuple) else [node.args[1]]
            known = [_KINDS.get(kind.id) if isinstance(kind, ast.Name) else None for kind in kinds]
            if type(values[0]) is Opaque or None in known:
                return Opaque()
            return isinstance(values[0], tuple(kind for group in known if group for kind in group))
        if name == "getattr" and len(values) > 1 and isinstance(values[1], str) and values[1] in OPERATIONS:
            return _Bound(values[0], values[1])
        return Opaque()
