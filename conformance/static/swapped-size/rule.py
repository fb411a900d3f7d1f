"""XPL175: Width and height of an image keep their places."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Edit, Finding, Fix, rule
from xpl_cli.audit.static.edits import exchanged
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, dotted, last

_MENTIONED: Final = re.compile(r"[rR]esize\(|interpolate\(")
_TALL: Final = re.compile(r"(.*_)?(h|height|rows)(_\d+)?|(img|image|new|target|out)_?h|H")
_WIDE: Final = re.compile(r"(.*_)?(w|width|cols)(_\d+)?|(img|image|new|target|out)_?w|W")


@rule(code="XPL175", requirement="XPL-IMG-4")
def swapped_size(source: Source) -> Iterator[Finding]:
    """Width and height change places between two libraries.

    ## What it does
    Looks at the sizes that are handed to functions which resize: cv2 and PIL want (width, height), torchvision and
    `torch.nn.functional.interpolate` (height, width), arrays have (height, width, channels). Names that say height and
    width, and the first two entries of an array's `shape`, are compared with what the function wants.

    ## Why it matters
    The image is stretched into the other format: a 640 x 480 picture becomes 480 wide. Nothing fails, objects are in
    other places than they were in training, and the score is low.

    ## Example
    `cv2.resize(image, image.shape[:2])`.

    ## Use instead
    `height, width = image.shape[:2]` and `cv2.resize(image, (width, height))`.

    ## Fix safety
    The fix exchanges the two. Data that was converted with them exchanged has to be converted again.
    """
    for file in source.python_files:
        if _MENTIONED.search(source.text(file)):
            for function in source.functions(file):
                yield from _in_function(source, function)


def _in_function(source: Source, function: Function) -> Iterator[Finding]:
    for call in function.of(ast.Call):
        wanted = _wanted(call)
        size = _size(call, wanted) if wanted else None
        if size is None or wanted is None:
            continue
        pair = _pair(size, function)
        if pair == wanted or pair is None:
            continue
        edits: tuple[Edit, ...] = ()
        if isinstance(size, (ast.Tuple, ast.List)):
            edits = exchanged(source, function.file, size.elts[0], size.elts[1])
        yield Finding(
            f"{called(call)} takes ({wanted}) and gets ({pair}): the image is stretched into the other format",
            **source.at(function.file, size),
            expected=f"({wanted})",
            got=ast.unparse(size),
            fix=Fix("unsafe_edit" if edits else "advice", f"({wanted})", edits),
        )


def _wanted(call: ast.Call) -> str | None:
    """Return the order in which a function wants a size."""
    name = called(call)
    if last(name) == "resize" and (name.startswith(("cv2.", "cv.")) or len(call.args) == 1):
        is_array = any(word in name for word in ("jax", "np.", "tf.", "torch", "skimage", "transforms", "TF."))
        return None if is_array else "width, height"
    if last(name) == "Resize" and ("transforms" in name or name == "Resize"):
        return "height, width"
    if last(name) == "interpolate" and name.startswith(("F.", "torch.")):
        return "height, width"
    return None


def _size(call: ast.Call, wanted: str) -> ast.expr | None:
    for keyword in call.keywords:
        if keyword.arg in {"size", "dsize"}:
            return keyword.value
    place = 1 if last(called(call)) == "interpolate" or called(call).startswith(("cv2.", "cv.")) else 0
    return call.args[place] if len(call.args) > place and wanted else None


def _pair(size: ast.expr, function: Function) -> str | None:
    """Return what the two numbers of a size are, None where the code does not say."""
    if isinstance(size, ast.Name):
        given = [node.value for node in function.of(ast.Assign) if any(dotted(t) == size.id for t in node.targets)]
        return _pair(given[0], function) if len(given) == 1 and not isinstance(given[0], ast.Name) else None
    if isinstance(size, ast.Subscript) and isinstance(size.slice, ast.Slice):
        cut = (constant(size.slice.lower) if size.slice.lower else 0, constant(size.slice.upper), size.slice.step)
        shape = last(dotted(size.value)) == "shape"
        return "height, width" if shape and cut == (0, 2, None) else None
    if isinstance(size, (ast.Tuple, ast.List)) and len(size.elts) == 2:
        kinds = [_kind(entry) for entry in size.elts]
        return ", ".join(kinds) if sorted(kinds) == ["height", "width"] else None
    return None


def _kind(node: ast.expr) -> str:
    """Return `height` or `width` if an expression says that it is one, "" otherwise."""
    if isinstance(node, ast.Call) and called(node) in {"int", "round", "max", "min"} and len(node.args) == 1:
        return _kind(node.args[0])
    if isinstance(node, ast.Subscript):
        if last(dotted(node.value)) == "shape":
            place = constant(node.slice)
            return {0: "height", 1: "width"}.get(place, "") if isinstance(place, int) else ""
        name = constant(node.slice)
        return _named(name) if isinstance(name, str) else ""
    return _named(last(dotted(node)))


def _named(name: str) -> str:
    if _TALL.fullmatch(name):
        return "height"
    return "width" if _WIDE.fullmatch(name) else ""
