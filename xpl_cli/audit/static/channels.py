"""Find swaps of red and blue in code, and whether the swapped image may be BGR."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.audit.static.syntax import called, constant, enclosing, last, names, parameters, targets, texts

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function

_READS_BGR: Final = frozenset(("imread", "read", "retrieve", "VideoCapture"))
"""Functions of OpenCV that read files and videos, and return BGR."""
_WANTS_BGR: Final = frozenset(("imwrite", "write", "imencode", "imshow", "VideoWriter"))
_DECODES: Final = frozenset(("imdecode", "decode_image_bit", "decode_image"))
_DECODER: Final = re.compile(
    r"(?:^|_)decode\w*_(?:images?|imgs?|frames?|rgb|jpe?g|cameras?)(?:_|$)|(?:images?|imgs?|frames?|jpe?g)_decode"
)
"""Names of helpers that decode images: `_decode_frame`, `decode_camera_jpeg`."""
_BACKWARDS: Final = frozenset(("[2, 1, 0]", "(2, 1, 0)"))
_AXES: Final = 3
_READS_IMAGE: Final = "get_image"
_OBSERVED: Final = frozenset(
    (_READS_IMAGE, *(f"[{key}]" for key in (sdk.Obs.VISION, sdk.Camera.COLOR, *sdk.READ_ALIASES[sdk.Camera.COLOR])))
)
_IMAGE: Final = re.compile(r"(^|_)(images?|imgs?|rgb|frames?|pixels|colou?rs?)(_|$)")


@dataclass(frozen=True)
class ChannelSwap:
    """One swap of the first and the last channel.

    Attributes:
        claims_bgr: whether the code names its input BGR.
        decoded: whether its input was decoded in the same function, and the code does not convert to BGR.
        observed: whether its input is certainly an image of an observation, or a parameter named like one.
    """

    function: Function
    node: ast.expr
    claims_bgr: bool
    decoded: bool
    observed: bool


def channel_swaps(function: Function) -> Iterator[ChannelSwap]:
    """Yield the swaps in a function whose input is probably an image of the standard.

    Left out: images for a writer that needs BGR, images that OpenCV read from a file or video, and swaps under a
    condition on "bgr", which is then a setting.
    """
    candidates = [(node, *_swapped_image(node)) for node in function.of(ast.Call, ast.Subscript)]
    candidates = [entry for entry in candidates if entry[1] is not None]
    if not candidates or any(last(called(node)) == "imencode" for node in function.nodes):
        return  # no swap, or a round trip through a codec
    sources = _sources(function)
    for node, image, claims_bgr in candidates:
        if image is None:
            continue
        origin = _origin(image)
        for name in names(image):
            origin |= sources.get(name, set())
        if origin & _READS_BGR or _is_for_a_writer(node, function) or _is_a_setting(node, function):
            continue
        is_decoded = any(map(_decodes, origin)) and not _converts_to_bgr(node)
        yield ChannelSwap(function, node, claims_bgr, is_decoded, _is_observed(origin))


def _decodes(name: str) -> bool:
    """Return whether a function of this name decodes an image to RGB; names with "bgr" do not."""
    return name in _DECODES or (_DECODER.search(name.lower()) is not None and "bgr" not in name.lower())


def _swapped_image(node: ast.AST) -> tuple[ast.expr | None, bool]:
    """Return the image whose channels a node swaps, and whether the code names it BGR."""
    if isinstance(node, ast.Call):
        if last(called(node)) == "cvtColor" and len(node.args) > 1:
            code = last(ast.unparse(node.args[1]))
            return (node.args[0] if code in {"COLOR_BGR2RGB", "COLOR_RGB2BGR"} else None), code == "COLOR_BGR2RGB"
        return _flipped_image(node), False
    if not isinstance(node, ast.Subscript) or not isinstance(node.ctx, ast.Load):
        return None, False
    indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else []
    if len(indices) < _AXES and not any(map(_is_ellipsis, indices)):
        return None, False  # `[:, ::-1]` is a mirror
    channels = indices[-1]
    backwards = isinstance(channels, ast.Slice) and channels.lower is channels.upper is None
    if backwards and constant(getattr(channels, "step", None)) == -1:
        return node.value, False
    return (node.value if ast.unparse(channels) in _BACKWARDS else None), False


def _flipped_image(node: ast.Call) -> ast.expr | None:
    """Return the image of `np.flip(image, -1)`, `image.flip(-1)` or `np.take(image, [2, 1, 0], axis=-1)`."""
    name, axes = last(called(node)), {"axis", "dims", "dim"}
    axis_arguments = [keyword.value for keyword in node.keywords if keyword.arg in axes]
    if name == "take" and len(node.args) > 1 and ast.unparse(node.args[1]) in _BACKWARDS:
        axis_arguments += node.args[2:]
    elif name == "flip" and node.args:
        axis_arguments += node.args[1:] if len(node.args) > 1 or axis_arguments else node.args
    else:
        return None
    if len(axis_arguments) != 1 or ast.unparse(axis_arguments[0]).strip("()[],") not in {"-1", "2"}:
        return None
    is_method = isinstance(node.func, ast.Attribute) and axis_arguments[0] is node.args[0]
    return node.func.value if is_method and isinstance(node.func, ast.Attribute) else node.args[0]


def _is_ellipsis(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is Ellipsis


def _converts_to_bgr(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and any("RGB2BGR" in ast.unparse(argument) for argument in node.args[1:])


def _origin(node: ast.AST) -> set[str]:
    """Return the functions that an expression calls, and the keys it reads in brackets: `get_image`, `[vision]`."""
    return {last(called(call)) for call in ast.walk(node) if isinstance(call, ast.Call)} | {
        f"[{text}]" for text in texts(node)
    }


def _is_observed(origin: set[str]) -> bool:
    return bool(origin & _OBSERVED) or any(key.startswith("[cam_") for key in origin)


def _sources(function: Function) -> dict[str, set[str]]:
    """Return, for each name, the functions and keys that its value comes from, through other names and loops.

    A parameter named like an image counts as one of the observation.
    """
    images = filter(_IMAGE.search, parameters(function.node))
    origins: dict[str, set[str]] = {name: {_READS_IMAGE} for name in images}
    for _ in range(3):
        for node in function.nodes:
            value = node.iter if isinstance(node, (ast.For, ast.comprehension)) else getattr(node, "value", None)
            if isinstance(node, (ast.Assign, ast.AnnAssign, ast.For, ast.comprehension)) and isinstance(
                value, ast.expr
            ):
                origin = _origin(value)
                for name in names(value):
                    origin |= origins.get(name, set())
                bound = [node.target] if isinstance(node, ast.comprehension) else targets(node)
                for target in bound:
                    if isinstance(target, ast.Name):
                        origins.setdefault(target.id, set()).update(origin)
    return origins


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
    identifiers = {word.lower() for condition in conditions for word in texts(condition.test) | names(condition.test)}
    attributes = (
        entry
        for outer in enclosing(node, function.up)
        if isinstance(outer, (ast.If, ast.IfExp))
        for entry in ast.walk(outer.test)
        if isinstance(entry, ast.Attribute)
    )
    return any("bgr" in word or "swap" in word for word in identifiers | {entry.attr.lower() for entry in attributes})
