"""Files that are searched in several places: the one that was requested, and others that are taken if it is missing."""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING, Final, NamedTuple

from xpl_cli.audit.static.model_class import LOADING
from xpl_cli.audit.static.syntax import called, constant, dotted, last, names, parameters, targets

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.static.function import Function
    from xpl_cli.audit.static.model_class import ModelClass

_EXISTS: Final = frozenset(("is_file", "exists", "isfile", "is_dir", "isdir"))
_WEIGHTS: Final = (".pt", ".pth", ".ckpt", ".safetensors", ".bin", ".npz")
_BUILDS: Final = frozenset(
    ("Path", "join", "joinpath", "str", "expanduser", "expandvars", "resolve", "absolute", "abspath", "format", "strip")
)
"""Calls whose result is a path with the names of their arguments in it."""
_REQUEST: Final = re.compile(
    r"ckpt|checkpoint|weight|model_(?:path|dir)|stats|statistics|prefer|run_dir", re.IGNORECASE
)
"""Names of what a run requests."""


class Substitute(NamedTuple):
    """A place that is looked at if what was requested is not there.

    Attributes:
        function, node: where it is.
        requested: the place that was requested, as it is written.
    """

    function: Function
    node: ast.expr
    requested: str


def substitutes(adapter: ModelClass) -> Iterator[Substitute]:
    """Yield, in what loading reaches, places that do not depend on what was requested, behind one that does."""
    reads = {id(setting.read.node): str(setting.read.key) for setting in adapter.settings}
    for function in adapter.reach(*LOADING):
        requested = _requested(function, reads)
        for places in (*_branches(function), *_lists(function)):
            for place, node in enumerate(places):
                wanted = next((one for one in places[:place] if _names(one, function) & requested), None)
                if wanted is None or ast.unparse(node) in {ast.unparse(part) for part in ast.walk(wanted)}:
                    continue  # the folder of what was requested may be what was requested itself
                if not _names(node, function) & requested:
                    yield Substitute(function, node, ast.unparse(wanted))
                    break


def nested_listings(adapter: ModelClass) -> Iterator[tuple[Function, ast.Call, str]]:
    """Yield, in what loading reaches, listings of all folders below a checkpoint's, by a pattern of weights."""
    for function in adapter.reach(*LOADING):
        for call in function.of(ast.Call):
            pattern = constant(call.args[0]) if call.args else None
            if not isinstance(pattern, str) or not pattern.endswith(_WEIGHTS) or "*" not in pattern.rpartition("/")[2]:
                continue
            if _method(call) == "rglob" or (_method(call) == "glob" and pattern.startswith("**/")):
                yield function, call, pattern


def _requested(function: Function, reads: dict[int, str]) -> set[str]:
    """Return the names of a function that hold what a run requests: from the configuration or the environment."""
    found = {name for name in parameters(function.node) if _REQUEST.search(name)}
    for node in function.of(ast.Assign):
        parts = list(ast.walk(node.value))
        of_environment = any(dotted(part) == "os.environ" or last(called(part)) == "getenv" for part in parts)
        keys = [reads[id(part)] for part in parts if id(part) in reads]
        if any(map(_REQUEST.search, keys)) or (of_environment and _REQUEST.search(ast.unparse(node))):
            found |= {target.id for target in targets(node) if isinstance(target, ast.Name)}
    return found


def _names(node: ast.expr, function: Function) -> set[str]:
    """Return the names that a path is made of, through local names; those that only choose one do not count."""
    made: dict[str, list[ast.expr]] = {}
    for assignment in function.of(ast.Assign):
        for target in targets(assignment):
            if isinstance(target, ast.Name):
                made.setdefault(target.id, []).append(assignment.value)
    found: set[str] = set()
    waiting: list[ast.AST] = [node]
    while waiting:
        one = waiting.pop()
        if isinstance(one, ast.IfExp):
            waiting += [one.body, one.orelse]
        elif isinstance(one, ast.Call) and _method(one) not in _BUILDS:
            continue
        elif isinstance(one, ast.Name):
            if one.id not in found:
                found.add(one.id)
                waiting += made.get(one.id, [])
        else:
            waiting += ast.iter_child_nodes(one)
    return found


def _method(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else last(called(call))


def _branches(function: Function) -> Iterator[list[ast.expr]]:
    """Yield the places that consecutive branches return, each if it exists."""
    for node in function.nodes:
        for block in (getattr(node, name, None) for name in ("body", "orelse")):
            places = (
                [place for one in block if (place := _returned(one)) is not None] if isinstance(block, list) else []
            )
            if len(places) > 1:
                yield places


def _returned(statement: ast.stmt) -> ast.expr | None:
    """Return the place of `if place.is_file(): return place`."""
    if not isinstance(statement, ast.If) or not statement.body or statement.orelse:
        return None
    tested = _tested(statement.test)
    end = statement.body[-1]
    is_it = isinstance(end, ast.Return) and end.value is not None and tested is not None
    return tested if is_it and tested is not None and names(tested) & names(end) else None


def _tested(test: ast.expr) -> ast.expr | None:
    """Return the path of which a test asks whether it exists."""
    if not isinstance(test, ast.Call) or last(called(test)) not in _EXISTS:
        return None
    if test.args:
        return test.args[0]
    return test.func.value if isinstance(test.func, ast.Attribute) else None


def _lists(function: Function) -> Iterator[list[ast.expr]]:
    """Yield the entries of lists of which a loop takes the first that exists."""
    for loop in function.of(ast.For):
        entry = loop.target.id if isinstance(loop.target, ast.Name) else ""
        takes = any(
            isinstance(node, ast.If)
            and (tested := _tested(node.test)) is not None
            and entry in names(tested)
            and any(isinstance(child, (ast.Return, ast.Break)) for child in ast.walk(node))
            for node in ast.walk(loop)
        )
        if entry and takes and isinstance(loop.iter, (ast.Name, ast.List, ast.Tuple)):
            yield _entries(function, loop.iter)


def _entries(function: Function, listed: ast.Name | ast.List | ast.Tuple) -> list[ast.expr]:
    """Return the entries of a list in their order, those that are added later too."""
    if not isinstance(listed, ast.Name):
        return list(listed.elts)
    found: list[tuple[int, ast.expr]] = []
    for node in function.nodes:
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == listed.id for t in targets(node)):
            found += [(entry.lineno, entry) for entry in getattr(node.value, "elts", [])]
        elif (
            isinstance(node, ast.Call) and called(node) in {f"{listed.id}.append", f"{listed.id}.extend"} and node.args
        ):
            added = getattr(node.args[0], "elts", node.args[:1]) if _method(node) == "extend" else node.args[:1]
            found += [(entry.lineno, entry) for entry in added]
    return [entry for _, entry in sorted(found, key=lambda one: one[0]) if not isinstance(entry, ast.Constant)]
