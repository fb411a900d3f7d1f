"""What native.py takes from the adapter that it is to be a second reading of: xpl, model.py, the native block.

Whoever wants to hide it from a reader can, and recording sees what is imported. This tells those who did not know.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.audit.static.native.folding import UNKNOWN, Folding, consumed
from xpl_cli.audit.static.native.places import standing
from xpl_cli.audit.static.syntax import called, dotted, last
from xpl_cli.native import names
from xpl_cli.native.reading import Import, Place, read_tree

if TYPE_CHECKING:
    from typing import Any

    from xpl_cli.audit.static.source import Source

_MODEL = sdk.File.MODEL_PY.removesuffix(".py")
_IMPORTING = frozenset(("import_module", "__import__", "run_module", "find_spec", "resolve_name"))
_TEXTS = (ast.Constant, ast.BinOp, ast.JoinedStr, ast.Call)
_MOST_FILES = 5000


@dataclass(frozen=True)
class Borrowed:
    """One thing that is taken.

    Attributes:
        what: what it is: "xpl", "model.py" or "policy.yml".
        by: how it is taken.
        place: where, for a `Finding`.
    """

    what: str
    by: str
    place: dict[str, Any]


def borrowed(source: Source) -> Iterator[Borrowed]:
    """Yield all that native.py, and the package's own files that it imports, take from the adapter, each line once."""
    seen = set()
    for file in source.reached(names.CODE):
        for found in _in_file(source, file) if file != sdk.File.MODEL_PY and source.parses(file) else ():
            key = found.what, found.place["path"], found.place["line"]
            if key not in seen:
                seen.add(key)
                yield found


def _in_file(source: Source, file: str) -> Iterator[Borrowed]:
    tree, nodes = source.tree(file), source.nodes(file)
    for item in read_tree(tree).imports:
        what = _imported(source, file, item)
        if what:
            yield Borrowed(what, "imports", standing(source, file, item.place))
    folding = Folding(tree, {"__package__": source.path.name})
    passed_over = consumed(nodes) | _spoken(tree)
    for node in nodes:
        name = _module_name(node)
        if name is not None:
            module = folding.text(name).removeprefix("/")
            stem = module.lstrip(".")
            item = Import(stem, len(module) - len(stem), (), Place.of(name))
            what = None if UNKNOWN in module else _imported(source, file, item)
            if what:
                yield Borrowed(what, "imports", source.at(file, node))
        elif isinstance(node, _TEXTS) and id(node) not in passed_over:
            what = _own_file(source, folding.text(node))
            if what:
                yield Borrowed(what, "names the file of", source.at(file, node))


def _imported(source: Source, file: str, item: Import) -> str | None:
    """Return what of the adapter an import takes."""
    if item.takes_sdk:
        return "xpl"
    if item.level:
        is_root = item.level == file.count("/") + 1
        is_model = item.module == _MODEL or (not item.module and _MODEL in item.names)
        return sdk.File.MODEL_PY if is_root and is_model else None
    if item.takes_adapter(source.path.name):
        return sdk.File.MODEL_PY
    is_ours = item.module.partition(".")[0] == _MODEL and source.has(sdk.File.MODEL_PY)
    return sdk.File.MODEL_PY if is_ours and not _has_another(source) else None


def _has_another(source: Source) -> bool:
    """Tell whether the package holds a module `model` besides its own, such as that of the authors' code."""
    folders = ((folder, inner, files) for folder, inner, files in os.walk(source.path) if folder != str(source.path))
    return any(sdk.File.MODEL_PY in files or _MODEL in inner for _, inner, files in islice(folders, _MOST_FILES))


def _module_name(node: ast.AST) -> ast.expr | None:
    """Return the expression that says which module is taken, if a node takes one by its name."""
    if isinstance(node, ast.Call) and node.args and last(called(node)) in _IMPORTING:
        return node.args[0]
    if isinstance(node, ast.Subscript) and dotted(node.value) == "sys.modules":
        return node.slice
    return None


def _own_file(source: Source, text: str) -> str | None:
    """Return which file of the adapter a path leads to."""
    *folders, name = [part for part in text.replace("\\", "/").split("/") if part not in {"", ".", ".."}] or [""]
    if name in {sdk.File.MODEL_PY, sdk.File.POLICY_YML} and set(folders) <= {source.path.name}:
        return name
    return None


def _spoken(tree: ast.Module) -> set[int]:
    """Return the identities of texts that are no names of files to open: docstrings, and the sources of conventions."""
    found = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in tree.body:
        defined = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        if any(isinstance(target, ast.Name) and target.id == names.CONVENTIONS for target in defined):
            found.update(map(id, ast.walk(node)))
    return found
