"""XPL127: Loading leaves checkpoint files unchanged."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import LOADING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import assigned, called, constant, last, names

_CHECKPOINT = re.compile(r"ckpt|checkpoint|run_dir|model_dir|model_path|pretrained|weights", re.IGNORECASE)
_WRITES = {
    "write_text": None,
    "write_bytes": None,
    "unlink": None,
    "save": 1,
    "save_file": 1,
    "remove": 0,
    "move": 1,
    "copy": 1,
    "copyfile": 1,
    "copy2": 1,
    "rename": 0,
    "replace": None,
    "rmtree": 0,
}
"""Calls that change a file, and which argument is its path; None where the object is."""
_LIBRARIES = frozenset(("os", "shutil", "torch", "np", "numpy", "json", "safetensors"))


@rule(code="XPL127", requirement="XPL-CKP-2")
def checkpoint_written(source: Source) -> Iterator[Finding]:
    """Loading the model changes files of the checkpoint.

    ## What it does
    Follows what `load` reaches, and looks for files that are written, overwritten or deleted at a path derived from the
    checkpoint's.

    ## Why it matters
    The checkpoint is no longer the published one: its hash differs, and its next user gets other results. Two servers
    that start on one checkpoint race; a crash while writing leaves it broken; a read-only store fails.

    ## Example
    The adapter rewrites the checkpoint's `dataset_statistics.json` from a fallback if a key is missing.

    ## Use instead
    Keep changed values in memory, or write them to a temporary folder that the model loads from.

    ## Fix safety
    No automatic fix.
    """
    for function in ModelClass.of(source).reach(*LOADING):
        for node, path in _written(function):
            root = _root(function, path)
            if root is not None:
                yield Finding(
                    (
                        f"loading changes the checkpoint (at {root}): its next user loads another one, and two "
                        "servers race"
                    ),
                    **source.at(function.file, node),
                    expected="checkpoint files as they were published",
                    got=ast.unparse(node),
                    fix=Fix("advice", "keep the change in memory, or write a copy to a temporary folder"),
                )
                break


def _written(function: Function) -> Iterator[tuple[ast.Call, ast.expr]]:
    """Yield calls that change a file, with its path."""
    for node in function.nodes:
        if not isinstance(node, ast.Call):
            continue
        name = called(node)
        owner = node.func.value if isinstance(node.func, ast.Attribute) else None
        if last(name) == "open":
            is_method = (
                owner is not None and name != "os.open" and name.partition(".")[0] not in {"io", "gzip", "codecs"}
            )
            arguments = node.args if is_method else node.args[1:]
            mode = next(
                (entry.value for entry in node.keywords if entry.arg == "mode"), arguments[0] if arguments else None
            )
            if re.search(r"[wax+]", str(constant(mode)) if isinstance(constant(mode), str) else ""):
                path = owner if is_method else next(iter(node.args), None)
                if path is not None:
                    yield node, path
        elif last(name) in _WRITES and owner is not None:
            path_index = _WRITES[last(name)]
            if path_index is None and name.partition(".")[0] not in _LIBRARIES and last(name) != "replace":
                yield node, owner
            elif path_index is not None and name.partition(".")[0] in _LIBRARIES and len(node.args) > path_index:
                yield node, node.args[path_index]


def _root(function: Function, path: ast.expr) -> str | None:
    """Return the name of a checkpoint that a path is made of, through the names of the function."""
    made = assigned(function.nodes)
    waiting, visited = [path], set()
    while waiting:
        value = waiting.pop()
        for node in ast.walk(value):
            name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
            if "tempfile" in name or "mkdtemp" in name:
                return None
            if _CHECKPOINT.search(name) and not isinstance(getattr(node, "ctx", None), ast.Store):
                return name
        waiting += [made[name] for name in names(value) if name in made and name not in visited]
        visited |= names(value)
    return None
