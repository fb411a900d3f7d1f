"""Functions of an adapter: their nodes, and the attributes of `self` that they change."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Literal, TypeVar, cast

from xpl_cli.audit.static.syntax import FunctionNode, called, last, self_attribute, targets

_Node = TypeVar("_Node", bound=ast.AST)

GROWING: Final = frozenset(
    ("append", "appendleft", "extend", "extendleft", "insert", "add", "update", "put", "push", "setdefault")
)
"""Methods that add to a container."""

Kind = Literal["assigned", "keyed", "grown"]


@dataclass(frozen=True)
class Function:
    """A function or method and its file."""

    file: str
    node: FunctionNode
    owner: ast.ClassDef | None = None

    @property
    def name(self) -> str:
        """Its name."""
        return self.node.name

    @cached_property
    def nodes(self) -> tuple[ast.AST, ...]:
        """Everything in it, the outermost first."""
        return tuple(ast.walk(self.node))

    @cached_property
    def kinds(self) -> dict[type[ast.AST], list[ast.AST]]:
        """Its nodes by their type, each list in the order of `nodes`."""
        by_type: dict[type[ast.AST], list[ast.AST]] = {}
        for node in self.nodes:
            by_type.setdefault(type(node), []).append(node)
        return by_type

    def of(self, *kinds: type[_Node]) -> list[_Node]:
        """Return its nodes of some types."""
        found = [node for kind in kinds for node in self.kinds.get(kind, ())]
        return cast("list[_Node]", found)

    @cached_property
    def writes(self) -> tuple[Write, ...]:
        """Its changes of attributes of `self`."""
        return tuple(writes([self]))

    @cached_property
    def assignments(self) -> list[tuple[ast.expr, ast.expr]]:
        """The target and the value of each assignment; a value that is unpacked is listed with each of its targets."""
        settings: list[ast.Assign | ast.AnnAssign] = [*self.of(ast.Assign), *self.of(ast.AnnAssign)]
        return [(target, node.value) for node in settings if node.value is not None for target in targets(node)]

    @cached_property
    def up(self) -> dict[ast.AST, ast.AST]:
        """The parent of each of its nodes."""
        return {child: parent for parent in self.nodes for child in ast.iter_child_nodes(parent)}


@dataclass(frozen=True)
class Write:
    """One change of an attribute by a method.

    Attributes:
        kind: `assigned`, `keyed` (one entry is set), or `grown` (modified depending on its value).
    """

    attribute: str
    kind: Kind
    function: Function
    node: ast.stmt | ast.expr

    @property
    def line(self) -> int:
        """Its line in the file."""
        return self.node.lineno


def writes(functions: list[Function]) -> Iterator[Write]:
    """Yield every change of an attribute of `self` in these functions."""
    for function in functions:
        for node in function.nodes:
            if isinstance(node, (ast.Assign, ast.AnnAssign, ast.AugAssign, ast.NamedExpr)):
                plain: Kind = "grown" if isinstance(node, ast.AugAssign) else "assigned"
                for target in targets(node):
                    attribute = self_attribute(target)
                    if attribute is not None:
                        yield Write(attribute, "keyed" if _has_key(target) else plain, function, node)
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in GROWING:
                attribute = self_attribute(_entry_of(node.func.value))
                if attribute is not None:
                    keyed = _has_key(node.func.value) or node.func.attr == "setdefault"
                    yield Write(attribute, "keyed" if keyed else "grown", function, node)


def _entry_of(node: ast.expr) -> ast.expr:
    """Return the dict of a look-up with a default: `self.x` of `self.x.setdefault(k, [])`."""
    while isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "setdefault":
        node = node.func.value
    return node


def _has_key(node: ast.expr) -> bool:
    """Return whether a node is an entry of the attribute: `self.x[k]`, `self.x[k].y`, `self.x.setdefault(k, [])`."""
    return any(
        isinstance(child, ast.Subscript)
        or (isinstance(child, ast.Call) and last(called(child)) in {"setdefault", "get"})
        for child in ast.walk(node)
    )


@dataclass(frozen=True)
class Symbols:
    """The classes and functions of the boundary by their names in one file."""

    classes: dict[str, tuple[str, ast.ClassDef]] = field(default_factory=dict)
    functions: dict[str, Function] = field(default_factory=dict)
