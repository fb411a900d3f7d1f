"""What an adapter remembers between calls: which attributes its operations write, read, and forget at reset."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from xpl_cli.audit.static.syntax import called, dotted, enclosing, last, self_attribute, targets, texts

if TYPE_CHECKING:
    from xpl_cli.audit.static.adapter import Function

_GROWING: Final = frozenset(
    ("append", "appendleft", "extend", "extendleft", "insert", "add", "update", "put", "push", "setdefault")
)
_SHRINKING: Final = frozenset(("clear", "pop", "popleft", "popitem", "remove", "discard"))

_BOOKKEEPING: Final = re.compile(
    r"latenc|timing|elapsed|profil|debug|_log|metric|n(?:um)?_calls|call_count|request|warn", re.IGNORECASE
)
_REPORTS: Final = frozenset(("print", "log", "info", "debug", "warning"))

Kind = Literal["assigned", "keyed", "grown"]


@dataclass(frozen=True)
class Write:
    """One place where a method changes an attribute.

    Attributes:
        kind: `assigned` anew, `keyed` (one entry of it), or `grown` (changed in a way that depends on what was there).
    """

    attribute: str
    kind: Kind
    function: Function
    node: ast.stmt | ast.expr

    @property
    def line(self) -> int:
        """Where it stands in its file."""
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
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _GROWING:
                attribute = self_attribute(node.func.value)
                if attribute is not None:
                    keyed = _has_key(node.func.value) or node.func.attr == "setdefault"
                    yield Write(attribute, "keyed" if keyed else "grown", function, node)


def _has_key(node: ast.expr) -> bool:
    """Tell whether an entry of the attribute is meant: `self.x[k]`, `self.x[k].y`, `self.x.setdefault(k, [])`."""
    return any(
        isinstance(child, ast.Subscript)
        or (isinstance(child, ast.Call) and last(called(child)) in {"setdefault", "get"})
        for child in ast.walk(node)
    )


def mentioned(functions: list[Function]) -> set[str]:
    """Return every attribute of `self` that these functions name; a reset that names one is believed to reset it."""
    return {
        node.attr
        for function in functions
        for node in function.nodes
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self"
    }


def read(functions: list[Function]) -> set[str]:
    """Return every attribute of `self` whose value these functions use, other than to report it or to change it."""
    return {
        node.attr
        for function in functions
        for node in function.nodes
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Load)
        and self_attribute(node) == node.attr
        and not _BOOKKEEPING.search(node.attr)
        and not _is_only_changed(node, function)
        and not is_reported(node, function)
    }


def is_memo(write: Write) -> bool:
    """Tell whether a write fills a cache: it happens only where the entry or the value is missing.

    Such an attribute holds what is computed anew just the same; it need not be forgotten.
    """
    inner: ast.AST = write.node
    for ancestor in enclosing(write.node, write.function.up):
        if isinstance(ancestor, ast.If) and write.attribute in _asked_whether_missing(ancestor.test, write.kind):
            return inner not in ancestor.orelse
        if isinstance(ancestor, ast.ExceptHandler) and ancestor.type is not None:
            return last(dotted(ancestor.type)) in {"KeyError", "AttributeError"}
        if ancestor is write.function.node:
            break
        inner = ancestor
    return False


def _asked_whether_missing(test: ast.expr, kind: Kind) -> set[str]:
    """Return the attributes whose absence a test asks for: `x not in self.a`, `self.a is None`, `not self.a`.

    A list that is filled where it is empty is no cache but a queue: of what grows, only a missing key counts.
    """
    found: set[str | None] = set()
    for node in ast.walk(test):
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.NotIn):
            found.add(self_attribute(node.comparators[0]))
        elif kind == "grown":
            continue
        elif isinstance(node, ast.Compare) and isinstance(node.ops[0], (ast.Is, ast.Eq)):
            found.add(self_attribute(node.left))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            found.add(self_attribute(node.operand))
            if isinstance(node.operand, ast.Call) and called(node.operand) == "hasattr":
                found.update(texts(node.operand))
    return {attribute for attribute in found if attribute is not None}


def _is_only_changed(node: ast.Attribute, function: Function) -> bool:
    """Tell whether a mention is the object of a call that only changes it, as in `self.a.append(x)`."""
    method = function.up.get(node)
    call = function.up.get(method) if isinstance(method, ast.Attribute) else None
    if isinstance(call, ast.Call) and call.func is method and isinstance(method, ast.Attribute):
        return method.attr in _GROWING | _SHRINKING and isinstance(function.up.get(call), ast.Expr)
    target = function.up.get(node)
    return isinstance(target, ast.Subscript) and isinstance(target.ctx, (ast.Store, ast.Del))


def is_reported(node: ast.AST, function: Function) -> bool:
    """Tell whether a mention only decides what is printed or logged."""
    inner = node
    for ancestor in enclosing(node, function.up):
        if last(called(ancestor)) in _REPORTS or isinstance(ancestor, ast.Raise):
            return True
        if isinstance(ancestor, ast.If) and inner is ancestor.test:
            return all(isinstance(entry, ast.Expr) and last(called(entry.value)) in _REPORTS for entry in ancestor.body)
        if isinstance(ancestor, ast.stmt):
            return False
        inner = ancestor
    return False
