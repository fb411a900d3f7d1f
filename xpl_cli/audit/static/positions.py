"""The list of environments that a batch is asked for, and stored observations that are taken by position instead."""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.syntax import called, self_attribute, targets

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.static.function import Function

_INDICES: Final = re.compile(r"env|idx|ind(ex|ices)|order|key|ids?$", re.IGNORECASE)
"""Attributes that hold the environments themselves."""
_COPIES: Final = frozenset(("list", "tuple", "copy", "deepcopy", "reversed"))


def names_of_list(function: Function, parameter: str) -> set[str]:
    """Return the names that hold a list that a function gets, under another name, copied, or with a default."""
    found = {parameter}
    for node in function.of(ast.Assign):
        if is_list(node.value, found):
            found.update(target.id for target in targets(node) if isinstance(target, ast.Name))
    return found


def is_list(value: ast.expr, aliases: set[str]) -> bool:
    """Tell whether a value is the list itself, a copy of it, or it where it is given."""
    if isinstance(value, ast.Name):
        return value.id in aliases
    if isinstance(value, ast.Call):
        return called(value) in {"list", "tuple", "copy"} and len(value.args) == 1 and is_list(value.args[0], aliases)
    if isinstance(value, ast.BoolOp):
        return any(is_list(entry, aliases) for entry in value.values)
    if isinstance(value, ast.IfExp):
        return is_list(value.body, aliases) or is_list(value.orelse, aliases)
    if isinstance(value, ast.ListComp):  # [int(env) for env in env_idx_list]
        return len(value.generators) == 1 and is_list(value.generators[0].iter, aliases) and _is_plain(value)
    return False


def _is_plain(value: ast.ListComp) -> bool:
    element = value.elt
    if isinstance(element, ast.Call) and called(element) in {"int", "str"} and len(element.args) == 1:
        element = element.args[0]
    return isinstance(element, ast.Name)


def pairings(function: Function, requested: set[str]) -> Iterator[ast.AST]:
    """Yield expressions that pair the requested environments with what an attribute of `self` holds, by position.

    Args:
        function: a method that gets the list of environments.
        requested: names of that list in it.
    """
    stored = _stored_names(function) - requested
    counters = _counters(function, requested)
    for node in function.of(ast.Subscript):
        if not _is_stored(node.value, stored) or not isinstance(node.ctx, ast.Load):
            continue
        if isinstance(node.slice, ast.Slice):
            if node.slice.upper is not None and _is_count(node.slice.upper, requested):
                yield node
        elif isinstance(node.slice, ast.Name) and node.slice.id in counters:
            yield node
    for call in function.of(ast.Call):
        is_pair = called(call) == "zip" and any(_is_requested(value, requested) for value in call.args)
        if is_pair and any(_is_stored(value, stored) for value in call.args):
            yield call


def _stored_names(function: Function) -> set[str]:
    """Return the names of attributes that this function does not set, and the local names of these."""
    written = {write.attribute for write in function.writes}
    stored: set[str] = set()
    for mention in function.of(ast.Attribute):
        attribute = self_attribute(mention)
        if attribute is not None and attribute not in written and not _INDICES.search(attribute):
            stored.add(f"self.{attribute}")
    for node in function.of(ast.Assign):  # of a name that is set twice, such as by a slice of itself, the first counts
        for target in targets(node):
            if isinstance(target, ast.Name) and _is_stored(node.value, stored):
                stored.add(target.id)
    return stored


def _is_stored(node: ast.expr, stored: set[str]) -> bool:
    """Tell whether an expression is a stored list, or a copy of one."""
    if isinstance(node, ast.Name):
        return node.id in stored
    if isinstance(node, ast.Attribute):
        return isinstance(node.value, ast.Name) and ast.unparse(node) in stored
    if isinstance(node, ast.Call) and called(node).rpartition(".")[2] in _COPIES and len(node.args) == 1:
        return _is_stored(node.args[0], stored)
    return False


def _counters(function: Function, requested: set[str]) -> set[str]:
    """Return the names that count the requested environments: of `enumerate`, or of a range as long."""
    found: set[str] = set()
    loops: list[ast.For | ast.comprehension] = [*function.of(ast.For), *function.of(ast.comprehension)]
    for loop in loops:
        if not isinstance(loop.iter, ast.Call):
            continue
        name, arguments = called(loop.iter), loop.iter.args
        if name == "enumerate" and arguments and _is_requested(arguments[0], requested):
            counter = loop.target.elts[0] if isinstance(loop.target, ast.Tuple) else loop.target
        elif name == "range" and arguments and _is_count(arguments[-1], requested):
            counter = loop.target
        else:
            continue
        if isinstance(counter, ast.Name):
            found.add(counter.id)
    return found


def _is_requested(node: ast.expr, requested: set[str]) -> bool:
    return isinstance(node, ast.Name) and node.id in requested


def _is_count(node: ast.expr, requested: set[str]) -> bool:
    return isinstance(node, ast.Call) and called(node) == "len" and any(_is_requested(v, requested) for v in node.args)
