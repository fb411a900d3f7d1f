"""What text an expression makes, as far as a reader can tell without running it: names of files and modules."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from xpl_cli.audit.static.syntax import called, last

if TYPE_CHECKING:
    from collections.abc import Collection

UNKNOWN = "?"
"""Stands for what cannot be told."""

_HERE = "__file__"
_JOINED = frozenset(("join", "joinpath", "with_name", "Path", "PurePath", "PosixPath", "str"))
_LONGEST, _DEEPEST = 5000, 24


class Folding:
    """The texts of one module.

    Args:
        tree: the module.
        known: texts of names that it does not define itself, such as `__package__`.
    """

    def __init__(self, tree: ast.Module, known: Mapping[str, str]) -> None:
        self._known = known
        self._texts: dict[int, str] = {}
        self._values: dict[str, ast.expr | None] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Assign):
                for target in node.targets:
                    if isinstance(target, ast.Name):  # None for a name that is given more than one value
                        self._values[target.id] = None if target.id in self._values else node.value

    def text(self, node: ast.AST, depth: int = _DEEPEST) -> str:
        """Return the text of an expression; `.` stands for the folder of the file, `?` for what cannot be told."""
        if id(node) not in self._texts:
            self._texts[id(node)] = UNKNOWN  # for a name that is made of itself
            made = self._made(node, depth - 1) if depth else UNKNOWN
            self._texts[id(node)] = made if len(made) <= _LONGEST else UNKNOWN
        return self._texts[id(node)]

    def _made(self, node: ast.AST, depth: int) -> str:
        if isinstance(node, ast.Constant):
            return node.value if isinstance(node.value, str) else UNKNOWN
        if isinstance(node, ast.Name):
            value = self._values.get(node.id)
            return self._known.get(node.id) or (UNKNOWN if value is None else self.text(value, depth))
        parts = _parts(node)
        if parts is not None:
            between, values = parts
            return between.join(self.text(value, depth) for value in values)
        return "." if _is_here(node) else UNKNOWN


def _parts(node: ast.AST) -> tuple[str, list[ast.expr]] | None:
    """Return of what a text is put together, and what stands between; None if that cannot be told."""
    if isinstance(node, ast.JoinedStr):
        return "", node.values
    if isinstance(node, ast.FormattedValue):
        return "", [node.value]
    if isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Div)):
        return "/" if isinstance(node.op, ast.Div) else "", [node.left, node.right]
    if isinstance(node, ast.Call) and last(called(node)) in _JOINED and node.args and not _is_here(node):
        return "/", [*_receiver(node), *node.args]
    return None


def consumed(nodes: Collection[ast.AST]) -> set[int]:
    """Return the identities of the expressions that are part of a larger text."""
    found: set[int] = set()
    for node in nodes:
        if isinstance(node, (ast.BinOp, ast.JoinedStr, ast.FormattedValue)):
            found.update(map(id, ast.iter_child_nodes(node)))
        elif isinstance(node, ast.Call) and last(called(node)) in _JOINED:
            found.update(id(value) for value in (*_receiver(node), *node.args))
    return found


def _receiver(node: ast.Call) -> Iterator[ast.expr]:
    """Yield what `x.joinpath(...)` is called on; `os.path.join` has a module there."""
    if isinstance(node.func, ast.Attribute) and node.func.attr in {"joinpath", "with_name"}:
        yield node.func.value


def _is_here(node: ast.AST) -> bool:
    """Tell whether an expression is made of the place of the file, such as `Path(__file__).resolve().parent`."""
    inner = list(ast.walk(node)) if isinstance(node, (ast.Attribute, ast.Call, ast.Subscript)) else []
    names = {child.id for child in inner if isinstance(child, ast.Name)}
    return _HERE in names and not any(
        isinstance(child, ast.Constant) and isinstance(child.value, str) for child in inner
    )
