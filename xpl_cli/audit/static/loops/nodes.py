"""An evaluation loop as a sequence of the nodes of its normalised syntax tree.

Brackets stand around children, so that order and nesting count. What is gone: docstrings, annotations, `pass`, comments
and layout; whether an operation of the policy is asked for by `call(func_name="reset")` or `reset()`, by keyword or by
position; names for values that the next statement alone uses. The environment and the client are known by their place
among the parameters, every other local name by what it was first given. Functions of the adapter that a loop calls are
part of it.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Mapping, Sequence
from copy import deepcopy
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.audit.static.adapter import symbols
from xpl_cli.audit.static.syntax import FunctionNode, constant, own, parameters

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function
    from xpl_cli.audit.static.source import Source

ENVIRONMENT: Final = "<environment>"
CLIENT: Final = "<client>"

_COMPREHENSIONS: Final = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
_SIMPLE: Final = (ast.Expr, ast.Assign, ast.AugAssign, ast.AnnAssign, ast.Return)
_SKIPPED: Final = (ast.expr_context, ast.arguments)


def nodes(function: FunctionNode) -> list[str]:
    """Return the nodes of an evaluation function that stands alone."""
    return _Writer(function, [ENVIRONMENT, CLIENT], {}).written


def nodes_of(function: Function, source: Source) -> list[str]:
    """Return the nodes of an evaluation function of an adapter, and of the adapter's functions that it calls."""
    written: list[str] = []
    seen: set[int] = set()
    waiting = [(function, [ENVIRONMENT, CLIENT])]
    for entry, given in waiting:  # grows while it is read
        if id(entry.node) not in seen:
            seen.add(id(entry.node))
            writer = _Writer(entry.node, given, symbols(source, entry.file).functions)
            written += writer.written
            waiting += writer.called
    return written


class _Writer:
    """Writes one function.

    Args:
        function: the function; it is not changed.
        given: what is known of its positional arguments.
        known: functions of the adapter by the names that they have here.

    Attributes:
        written: its nodes.
        called: functions of the adapter that it calls, with what is known of their arguments.
    """

    def __init__(self, function: FunctionNode, given: Sequence[str], known: Mapping[str, Function]) -> None:
        function = _inlined(function)
        self.called: list[tuple[Function, list[str]]] = []
        self._known = known
        names = parameters(function)
        self._labels = dict.fromkeys(names, "<parameter>") | dict(zip(names, given, strict=False))
        self._name_locals(function)
        self.written = self._block(function.body)

    def _name_locals(self, function: FunctionNode) -> None:
        for node in own(function):
            if isinstance(node, (ast.For, ast.AsyncFor, ast.comprehension)):
                self._name(node.target, f"item of {self._origin(node.iter)}")
            elif isinstance(node, ast.withitem) and node.optional_vars is not None:
                self._name(node.optional_vars, self._origin(node.context_expr))
            elif isinstance(node, (ast.Assign, ast.AnnAssign, ast.NamedExpr)) and node.value is not None:
                for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                    self._name(target, self._origin(node.value))

    def _name(self, target: ast.expr, origin: str) -> None:
        if isinstance(target, ast.Name):
            self._labels.setdefault(target.id, f"<{origin}>")
        elif isinstance(target, (ast.Tuple, ast.List)):
            for place, entry in enumerate(target.elts):
                self._name(entry, f"{place} in {origin}")

    def _origin(self, value: ast.expr) -> str:
        """Return in a word where a value comes from."""
        if isinstance(value, ast.Call):
            asked = self._asked(value)
            called = value.func.attr if isinstance(value.func, ast.Attribute) else self._origin(value.func)
            return called if asked is None else asked[0]
        if isinstance(value, ast.Name):
            return self._labels.get(value.id, value.id).strip("<>")
        return type(value).__name__

    def _asked(self, call: ast.Call) -> tuple[str, list[tuple[str, ast.expr]]] | None:
        """Return the operation of the policy that a call asks for, and the arguments by name."""
        function = call.func
        if not isinstance(function, ast.Attribute) or not isinstance(function.value, ast.Name):
            return None
        if self._labels.get(function.value.id) != CLIENT:
            return None
        names = [sdk.Payload.FUNC_NAME, sdk.Payload.OBS][function.attr != sdk.Message.CALL :]
        given = [*zip(names, call.args, strict=False), *((str(one.arg), one.value) for one in call.keywords)]
        if function.attr != sdk.Message.CALL:
            return function.attr, given
        name = constant(dict(given).get(sdk.Payload.FUNC_NAME))
        rest = [(key, value) for key, value in given if key != sdk.Payload.FUNC_NAME]
        return (name, rest) if isinstance(name, str) else None

    def _block(self, body: Sequence[ast.stmt]) -> list[str]:
        kept = [statement for statement in body if not isinstance(statement, ast.Pass) and not _is_text(statement)]
        return ["{", *(part for statement in kept for part in self._node(statement)), "}"]

    def _node(self, node: ast.AST) -> list[str]:
        match node:
            case ast.Name():
                written = [self._labels.get(node.id, node.id)]
            case ast.Constant():
                written = [repr(node.value)]
            case ast.Attribute():
                written = [*self._node(node.value), f".{node.attr}"]
            case ast.keyword():
                written = [f"{node.arg}=", *self._node(node.value)]
            case ast.AnnAssign():
                written = ["Assign(", *self._node(node.target), *self._field(node.value), ")"]
            case ast.Call():
                written = self._call(node)
            case _:
                children = [part for _, value in ast.iter_fields(node) for part in self._field(value)]
                name = type(node).__name__
                written = [f"{name}(", *children, ")"] if children else [name]
        return written

    def _field(self, value: object) -> list[str]:
        if value is None or isinstance(value, _SKIPPED):
            return []
        if isinstance(value, ast.AST):
            return self._node(value)
        if isinstance(value, list):
            if value and isinstance(value[0], ast.stmt):
                return self._block(value)
            return [part for entry in value for part in self._field(entry)]
        return [str(value)]

    def _call(self, call: ast.Call) -> list[str]:
        asked = self._asked(call)
        if asked is not None:
            given = [part for name, value in asked[1] for part in (f"{name}=", *self._node(value))]
            return [f"ask {asked[0]}(", *given, ")"]
        if isinstance(call.func, ast.Name) and call.func.id in self._known:
            self.called.append((self._known[call.func.id], [self._node(value)[0] for value in call.args]))
        return [*self._node(call.func), "(", *self._field(call.args), *self._field(call.keywords), ")"]


class _Put(ast.NodeTransformer):
    """Puts a value in the place of a name."""

    def __init__(self, name: str, value: ast.expr) -> None:
        self.name, self.value = name, value

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Replace the name where it is read."""
        return self.value if node.id == self.name and isinstance(node.ctx, ast.Load) else node


def _inlined(function: FunctionNode) -> FunctionNode:
    """Return a copy in which no name is left that only hands a value to the next statement."""
    function = deepcopy(function)
    blocks = [
        block
        for node in ast.walk(function)
        for name in ("body", "orelse", "finalbody")
        if isinstance(block := getattr(node, name, None), list)
    ]
    pairs = [pair for block in blocks for pair in pairwise(block)]
    handed = Counter(name for pair in pairs if (name := _hands_over(*pair)))
    single = {name for name, times in handed.items() if times == _reads(function, name)}
    for block in blocks:
        for first, second in list(pairwise(block)):
            if isinstance(first, ast.Assign) and _hands_over(first, second) in single:
                _Put(_hands_over(first, second), first.value).visit(second)
                block.remove(first)
    return function


def _hands_over(first: ast.stmt, second: ast.stmt) -> str:
    """Return the name by which a statement hands a value to the next one, which reads it once; "" if it does not."""
    if not isinstance(first, ast.Assign) or not isinstance(second, _SIMPLE):
        return ""
    if len(first.targets) != 1 or not isinstance(first.targets[0], ast.Name):
        return ""
    name = first.targets[0].id
    repeated = any(isinstance(node, _COMPREHENSIONS) and _reads(node, name) for node in ast.walk(second))
    return name if _reads(second, name) == 1 and not repeated else ""


def _reads(node: ast.AST, name: str) -> int:
    return sum(
        isinstance(child, ast.Name) and child.id == name and isinstance(child.ctx, ast.Load) for child in ast.walk(node)
    )


def _is_text(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
