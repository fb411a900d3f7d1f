"""The imports of an adapter that are certain to be carried out, and to end what they stand in if they fail."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.audit.static.names.offered import is_type_checking
from xpl_cli.audit.static.syntax import called, children, constant, dotted, is_broad, last, names, texts

if TYPE_CHECKING:
    from xpl_cli.audit.static.source import Source

_FAILURES: Final = frozenset(("ImportError", "ModuleNotFoundError"))
_ASKED: Final = frozenset(
    ("version", "__version__", "version_info", "find_spec", "hasattr", "exists", "is_file", "is_dir", "platform")
)
"""Words of a condition that may ask whether a module or name is there."""
_PATHS: Final = frozenset(("append", "insert", "extend"))


@dataclass(frozen=True)
class Imported:
    """One module that a statement imports.

    Attributes:
        level: number of leading dots.
        parts: the dotted name behind them.
        names: what is taken from it; empty for `import module`.
        is_path_known: whether nothing but the adapter's own folder is put into `sys.path`, so that a module of the
            adapter is meant where one bears the name.
    """

    file: str
    node: ast.Import | ast.ImportFrom
    level: int
    parts: tuple[str, ...]
    names: tuple[str, ...]
    is_path_known: bool

    @property
    def module(self) -> str:
        """The module as it is written."""
        return "." * self.level + ".".join(self.parts)


def live(source: Source) -> Iterator[Imported]:
    """Yield the imports of the boundary's Python files that nothing guards."""
    files = [name for name in source.python_files if source.parses(name)]
    scripts = [source.text(name) for name in source.text_files if name.endswith(".sh")]
    is_path_known = not any("PYTHONPATH" in script for script in scripts) and not any(
        _changes_path(node) for name in files for node in source.nodes(name)
    )
    for name, nodes in certain(source):
        for node in nodes:
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                for level, module, taken in _modules(node):
                    yield Imported(name, node, level, tuple(filter(None, module.split("."))), taken, is_path_known)


def certain(source: Source, *failures: str) -> Iterator[tuple[str, Iterator[ast.AST]]]:
    """Yield the boundary's Python files, each with the nodes at which an import that fails is not dealt with.

    Args:
        source: the adapter.
        failures: further errors that may be dealt with.
    """
    files = [name for name in source.python_files if source.parses(name)]
    ends = _FAILURES | {*failures}
    guarded = {word for name in files for word in _guarded_modules(source.nodes(name))}
    roots = {sdk.File.MODEL_PY, sdk.File.DEPLOY_PY, *(name for name in source.conversion_files)}
    for name in files:
        if name in roots or Path(name).stem not in guarded:
            tree = source.tree(name)
            body = [node for node in tree.body if name in source.conversion_files or not _is_for_scripts(node)]
            yield name, _unguarded(body, _guarded_calls(source.nodes(name), ends), ends)


def _modules(node: ast.Import | ast.ImportFrom) -> Iterator[tuple[int, str, tuple[str, ...]]]:
    if isinstance(node, ast.ImportFrom):
        yield node.level, node.module or "", tuple(alias.name for alias in node.names)
    else:
        for alias in node.names:
            yield 0, alias.name, ()


def _unguarded(nodes: Sequence[ast.AST], guarded: set[str], failures: frozenset[str]) -> Iterator[ast.AST]:
    """Yield nodes and all below them, in the order of the source; on a stack, because deep generators take long."""
    waiting = [*reversed(nodes)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, (ast.If, ast.IfExp)) and (is_type_checking(node.test) or _asks(node.test)):
            otherwise = node.orelse if isinstance(node.orelse, list) else [node.orelse]
            waiting += reversed(otherwise if is_type_checking(node.test) else ())
        elif not _is_guard(node, failures) and getattr(node, "name", None) not in guarded:
            yield node
            waiting += reversed(children(node))


def _is_guard(node: ast.AST, failures: frozenset[str]) -> bool:
    """Tell whether an import that fails inside is dealt with."""
    if isinstance(node, (ast.Try, ast.TryStar)):
        caught = {last(dotted(name)) for handler in node.handlers for name in ast.walk(handler.type or handler)}
        return bool(caught & failures) or any(map(is_broad, node.handlers))
    return isinstance(node, ast.With) and any(last(called(item.context_expr)) == "suppress" for item in node.items)


def _guards(nodes: Iterable[ast.AST], failures: frozenset[str]) -> Iterator[ast.AST]:
    return (inner for node in nodes if _is_guard(node, failures) for inner in ast.walk(node))


def _guarded_calls(nodes: Iterable[ast.AST], failures: frozenset[str]) -> set[str]:
    """Return the functions that are called where a failing import is dealt with."""
    return {last(called(node)) for node in _guards(nodes, failures) if isinstance(node, ast.Call)} - {""}


def _guarded_modules(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the modules that are imported where a failing import is dealt with."""
    for node in _guards(nodes, _FAILURES):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            for _, module, taken in _modules(node):
                yield from (*module.split("."), *taken)


def _is_for_scripts(node: ast.stmt) -> bool:
    """Tell whether something is run only where its file is called as a script, which a module of the adapter is not."""
    return isinstance(node, ast.If) and "__name__" in names(node.test)


def _asks(test: ast.expr) -> bool:
    attributes = {node.attr for node in ast.walk(test) if isinstance(node, ast.Attribute)}
    return bool(_ASKED & (attributes | names(test)))


def _changes_path(node: ast.AST) -> bool:
    """Tell whether a call puts a folder into `sys.path` that may not be the file's own."""
    owner = dotted(node.func.value) if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) else ""
    if isinstance(node, ast.Assign):
        return any(dotted(target) == "sys.path" for target in node.targets)
    if owner != "sys.path" or not isinstance(node, ast.Call) or last(called(node)) not in _PATHS:
        return last(called(node)) == "addsitedir"
    folder = node.args[-1] if node.args else node
    text = ast.unparse(folder)
    is_plain = not texts(folder) and constant(folder) is ...
    return not (is_plain and "__file__" in text and text.count("dirname") + text.count(".parent") == 1)
