"""Where code exchanges red and blue, and whether what it exchanges can have come as BGR."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.syntax import called, constant, enclosing, last, names, targets, texts

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function

_READS_BGR: Final = frozenset(("imread", "read", "retrieve", "VideoCapture"))
"""Functions of OpenCV that read standard files and videos, and give BGR."""
_WANTS_BGR: Final = frozenset(("imwrite", "write", "imencode", "imshow", "VideoWriter"))
_DECODES: Final = frozenset(("imdecode", "decode_image_bit", "decode_image"))


@dataclass(frozen=True)
class Swap:
    """One exchange of the first and the last channel.

    Attributes:
        claims_bgr: whether the code says that its input is BGR.
        decoded: whether its input was decoded in the same function.
    """

    function: Function
    node: ast.expr
    claims_bgr: bool
    decoded: bool


def swaps(function: Function) -> Iterator[Swap]:
    """Yield the exchanges in a function whose input is an image of the standard, as far as can be told.

    Left out: what goes straight to a writer that wants BGR, what was read from a file or video by OpenCV, and what
    happens only under a condition about "bgr", which is then somebody's setting.
    """
    found = [(node, *_swapped(node)) for node in function.of(ast.Call, ast.Subscript)]
    found = [entry for entry in found if entry[1] is not None]
    if not found or any(last(called(node)) == "imencode" for node in function.nodes):
        return  # nothing, or encoded and decoded again, to compress
    sources = _sources(function)
    for node, image, claims_bgr in found:
        if image is None:
            continue
        origin = {called(call).rpartition(".")[2] for call in ast.walk(image) if isinstance(call, ast.Call)}
        for name in names(image):
            origin |= sources.get(name, set())
        if origin & _READS_BGR or _is_for_a_writer(node, function) or _is_a_setting(node, function):
            continue
        yield Swap(function, node, claims_bgr, bool(origin & _DECODES))


def _swapped(node: ast.AST) -> tuple[ast.expr | None, bool]:
    """Return the image whose channels a node exchanges, and whether the code calls it BGR."""
    if isinstance(node, ast.Call) and last(called(node)) == "cvtColor" and len(node.args) > 1:
        code = last(ast.unparse(node.args[1]))
        if code == "COLOR_BGR2RGB":  # the opposite is asked for by something that wants BGR
            return node.args[0], True
    if not isinstance(node, ast.Subscript) or not isinstance(node.ctx, ast.Load):
        return None, False
    if isinstance(node.slice, ast.Tuple) and node.slice.elts:
        channels = node.slice.elts[-1]
        backwards = isinstance(channels, ast.Slice) and channels.lower is channels.upper is None
        if backwards and constant(getattr(channels, "step", None)) == -1:
            return node.value, False
        if ast.unparse(channels) == "[2, 1, 0]":
            return node.value, False
    return None, False


def _sources(function: Function) -> dict[str, set[str]]:
    """Return, for each name, the functions whose results it was made of, through other names and loops."""
    found: dict[str, set[str]] = {}
    for _ in range(3):
        for node in function.nodes:
            value = node.iter if isinstance(node, (ast.For, ast.comprehension)) else getattr(node, "value", None)
            if isinstance(node, (ast.Assign, ast.AnnAssign, ast.For, ast.comprehension)) and isinstance(
                value, ast.expr
            ):
                origin = {last(called(call)) for call in ast.walk(value) if isinstance(call, ast.Call)}
                for name in names(value):
                    origin |= found.get(name, set())
                bound = [node.target] if isinstance(node, ast.comprehension) else targets(node)
                for target in bound:
                    if isinstance(target, ast.Name):
                        found.setdefault(target.id, set()).update(origin)
    return found


def _is_for_a_writer(node: ast.AST, function: Function) -> bool:
    for outer in enclosing(node, function.up):
        if isinstance(outer, ast.Call) and last(called(outer)) in _WANTS_BGR:
            return True
        if isinstance(outer, ast.stmt):
            bound = {target.id for target in targets(outer) if isinstance(target, ast.Name)}
            writers = (
                call for call in function.nodes if isinstance(call, ast.Call) and last(called(call)) in _WANTS_BGR
            )
            return any(bound & names(argument) for call in writers for argument in call.args)
    return False


def _is_a_setting(node: ast.AST, function: Function) -> bool:
    conditions = (outer for outer in enclosing(node, function.up) if isinstance(outer, (ast.If, ast.IfExp)))
    words = {word.lower() for condition in conditions for word in texts(condition.test) | names(condition.test)}
    attributes = (
        entry
        for outer in enclosing(node, function.up)
        if isinstance(outer, (ast.If, ast.IfExp))
        for entry in ast.walk(outer.test)
        if isinstance(entry, ast.Attribute)
    )
    return any("bgr" in word or "swap" in word for word in words | {entry.attr.lower() for entry in attributes})
