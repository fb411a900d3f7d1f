"""Templates of instructions as a text of Python writes them: in reference.py, or where it says that the authors do."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.conventions.instruction import HOLE
from xpl_cli.basics.errors import UserError
from xpl_cli.model_io import names, reference_file

if TYPE_CHECKING:
    from pathlib import Path


_MOST_BYTES = 1 << 20
_MOST = 8
_LONGEST = 400
_SOURCE = re.compile(r"^\s*([\w./-]+\.py):(\d+)")
_AROUND = 12
"""Lines before and after the one that is named."""
_FIELD = re.compile(r"\{[^{}]*\}|%s")


def templates(folder: Path) -> list[str]:
    """Return the templates that reference.py of a package writes, and the place that it names as their source."""
    try:
        reference = reference_file.read_file(folder)
    except UserError:
        return []
    texts = list(_find_templates(folder / names.CODE, None))
    source = reference.conventions.get(sdk.Obs.INSTRUCTION)
    match = _SOURCE.match(source.text) if source is not None else None
    if match is not None:
        path = (folder / match[1]).resolve()
        if path.is_relative_to(folder.resolve()):
            texts = [*_find_templates(path, int(match[2])), *texts]
    return list(dict.fromkeys(texts))[:_MOST]


def _find_templates(path: Path, line: int | None) -> Iterator[str]:
    """Yield the templates in a file, or those near a line of it."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            return
        tree = ast.parse(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, SyntaxError, RecursionError, MemoryError):
        return
    inner = {id(node.left) for node in ast.walk(tree) if _is_sum(node)}  # type: ignore[attr-defined]
    for node in ast.walk(tree):
        near = line is None or abs(getattr(node, "lineno", line) - line) <= _AROUND
        if near and id(node) not in inner:
            text = _template(node)
            if text is not None and text.count(HOLE) == 1 and _is_prompt(text):
                yield text


def _is_prompt(text: str) -> bool:
    """Tell whether a text may be a prompt: names of fields have no spaces."""
    return " " in text.replace(HOLE, "") and len(text) < _LONGEST


def _is_sum(node: ast.AST) -> bool:
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add)


def _template(node: ast.AST) -> str | None:
    """Return the text of a node with a hole where something is put in, None if it has no such text."""
    if isinstance(node, ast.JoinedStr) or _is_sum(node):
        texts = [_constant(piece) for piece in _pieces(node)]
        return "".join(HOLE if text is None else text for text in texts) if any(texts) else None
    text = _constant(node)
    return _FIELD.sub(lambda _: HOLE, text) if text and len(_FIELD.findall(text)) == 1 else None


def _pieces(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what a text is put together of."""
    if isinstance(node, ast.BinOp) and _is_sum(node):
        yield from _pieces(node.left)
        yield from _pieces(node.right)
    elif isinstance(node, ast.JoinedStr):
        yield from node.values
    else:
        yield node


def _constant(node: ast.AST) -> str | None:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None
