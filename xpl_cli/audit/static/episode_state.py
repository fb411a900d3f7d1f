"""The state that an adapter keeps between calls: attributes that its operations write, read, and clear at reset."""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.function import GROWING
from xpl_cli.audit.static.syntax import called, dotted, enclosing, last, self_attribute, texts

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function, Kind, Write

_SHRINKING: Final = frozenset(("clear", "pop", "popleft", "popitem", "remove", "discard"))

_BOOKKEEPING: Final = re.compile(
    r"latenc|timing|elapsed|profil|debug|_log|metric|n(?:um)?_calls|call_count|request|warn", re.IGNORECASE
)
_REPORTS: Final = re.compile(
    r"(?:^|_|\b)(?:c|e|f|p|pp|r|w)?print(?:ln|_exc)?(?:_|$)|(?:^|_)(?:log|warn|warning|info|debug|critical|notice|tprint)(?:_|$)"
)
"""Names of functions that print or log: `cprint`, `log_once`, `_warn`."""


def mentioned_attributes(functions: list[Function]) -> set[str]:
    """Return every attribute of `self` that these functions mention; a reset counts as clearing those."""
    return {
        node.attr
        for function in functions
        for node in function.nodes
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self"
    }


def read_attributes(functions: list[Function]) -> set[str]:
    """Return every attribute of `self` whose value these functions use, except to log or modify it."""
    getattr_names = {
        str(node.args[1].value)
        for function in functions
        for node in function.of(ast.Call)
        if called(node) == "getattr"
        and len(node.args) > 1
        and dotted(node.args[0]) == "self"
        and isinstance(node.args[1], ast.Constant)
        and not is_reported(node, function)
    }
    return {name for name in getattr_names if not _BOOKKEEPING.search(name)} | {
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
    """Return whether a write fills a cache: it runs only if the entry or the value is missing.

    Recomputing such an attribute gives the same value, so it need not be cleared. An entry that is changed afterwards
    is no cache.
    """
    if write.kind == "keyed" and _entries_change(write):
        return False
    inner: ast.AST = write.node
    for ancestor in enclosing(write.node, write.function.up):
        if isinstance(ancestor, ast.If) and write.attribute in _missing_checks(ancestor.test, write.kind):
            return inner not in ancestor.orelse
        if isinstance(ancestor, ast.ExceptHandler) and ancestor.type is not None:
            return last(dotted(ancestor.type)) in {"KeyError", "AttributeError"}
        if ancestor is write.function.node:
            break
        inner = ancestor
    return False


def _entries_change(write: Write) -> bool:
    """Return whether the function that adds an entry also calls a method of it for its effect, each time it runs."""
    for node in write.function.of(ast.Expr):
        call = node.value
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Attribute):
            continue
        entry = call.func.value
        if isinstance(entry, ast.Subscript) and self_attribute(entry) == write.attribute and node is not write.node:
            guards = [outer for outer in enclosing(node, write.function.up) if isinstance(outer, ast.If)]
            if not any(write.attribute in _missing_checks(guard.test, write.kind) for guard in guards):
                return True
    return False


def _missing_checks(test: ast.expr, kind: Kind) -> set[str]:
    """Return the attributes whose absence a test checks: `x not in self.a`, `self.a is None`, `not self.a`.

    A list that is filled when it is empty is a queue and not a cache: for growing attributes only a missing key counts.
    """
    attributes: set[str | None] = set()
    for node in ast.walk(test):
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.NotIn):
            attributes.add(self_attribute(node.comparators[0]))
        elif kind == "grown":
            continue
        elif isinstance(node, ast.Compare) and isinstance(node.ops[0], (ast.Is, ast.Eq)):
            attributes.add(self_attribute(node.left))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            attributes.add(self_attribute(node.operand))
            if isinstance(node.operand, ast.Call) and called(node.operand) == "hasattr":
                attributes.update(texts(node.operand))
    return {attribute for attribute in attributes if attribute is not None}


def _is_only_changed(node: ast.Attribute, function: Function) -> bool:
    """Return whether an attribute is only modified by a call, as in `self.a.append(x)`."""
    method = function.up.get(node)
    call = function.up.get(method) if isinstance(method, ast.Attribute) else None
    if isinstance(call, ast.Call) and call.func is method and isinstance(method, ast.Attribute):
        return method.attr in GROWING | _SHRINKING and isinstance(function.up.get(call), ast.Expr)
    target = function.up.get(node)
    return isinstance(target, ast.Subscript) and isinstance(target.ctx, (ast.Store, ast.Del))


def is_reported(node: ast.AST, function: Function) -> bool:
    """Return whether a node only affects what is printed or logged."""
    inner = node
    for ancestor in enclosing(node, function.up):
        if _REPORTS.search(last(called(ancestor))) or isinstance(ancestor, ast.Raise):
            return True
        if isinstance(ancestor, ast.If) and inner is ancestor.test:
            return all(map(only_reports, ancestor.body))
        if isinstance(ancestor, ast.stmt):
            return False
        inner = ancestor
    return False


def only_reports(statement: ast.stmt) -> bool:
    """Return whether a statement only prints or logs, judged by the name of the function that it calls."""
    if isinstance(statement, ast.Pass):
        return True
    if not isinstance(statement, ast.Expr) or isinstance(statement.value, ast.Constant):
        return isinstance(statement, ast.Expr)
    name = called(statement.value)
    return bool(_REPORTS.search(last(name))) or (last(name) == "error" and "log" in name.lower())
