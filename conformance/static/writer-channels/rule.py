"""XPL185: What OpenCV writes has the channels that it expects."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.colour import decodes
from xpl_cli.audit.static.edits import replaced, written
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, last, names, targets, texts

_STILL: Final = frozenset(("cv2.imwrite", "cv2.imencode"))
_TURNS: Final = frozenset(("cvtColor", "flip"))


@rule(code="XPL185", requirement="XPL-IMG-1")
def writer_channels(source: Source) -> Iterator[Finding]:
    """Images that are RGB go to an OpenCV writer, which takes them for BGR.

    ## What it does
    Finds what `cv2.imwrite`, `cv2.imencode` and the `write` of a `cv2.VideoWriter` are given, and reports images that
    come from an observation or a trajectory, or from a helper whose name says that it decodes frames, in a function
    that exchanges no channels and calls none that does.

    ## Why it matters
    Red and blue are exchanged in the file. In a video only the person who watches is misled; in training data the
    policy learns the wrong colours and sees the right ones later.

    ## Example
    `cv2.imwrite(path, obs["vision"]["cam_head"]["color"])`.

    ## Use instead
    `cv2.imwrite(path, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))`, or `xpl.images`, which writes RGB.

    ## Fix safety
    Whoever reads the file with red and blue exchanged once more has to stop doing so.
    """
    for file in source.python_files:
        if any(name in source.text(file) for name in ("cv2.imwrite", "cv2.imencode", "cv2.VideoWriter")):
            for function in source.functions(file):
                yield from _in_function(source, function)


def _in_function(source: Source, function: Function) -> Iterator[Finding]:
    """Yield what one function hands to a writer as it came."""
    turning = {other.name for other in source.functions(function.file) if _exchanges(other)}
    calls = function.of(ast.Call)
    if not any(called(call) in _STILL or last(called(call)) == "write" for call in calls):
        return
    if _exchanges(function) or any(last(called(call)) in turning for call in calls):
        return
    writers = {
        target.id
        for node in function.of(ast.Assign)
        if called(node.value) == "cv2.VideoWriter"
        for target in targets(node)
        if isinstance(target, ast.Name)
    }
    for call in calls:
        is_video = last(called(call)) == "write" and called(call).rpartition(".")[0] in writers
        image = call.args[0] if is_video and call.args else call.args[1] if len(call.args) > 1 else None
        if image is None or not (is_video or called(call) in _STILL) or not _is_observed(image, function):
            continue
        text = f"cv2.cvtColor({written(source, function.file, image)}, cv2.COLOR_RGB2BGR)"
        yield Finding(
            f"{called(call)} takes RGB for BGR: red and blue are exchanged in what {function.name} writes",
            **source.at(function.file, image),
            expected=text,
            got=ast.unparse(image)[:80],
            fix=Fix("unsafe_edit", text, (replaced(source, function.file, image, text),)),
        )


def _exchanges(function: Function) -> bool:
    """Tell whether a function exchanges channels by a call or an index."""
    calls = function.of(ast.Call)
    return any(last(called(call)) in _TURNS or "bgr" in called(call).lower() for call in calls) or _turns(function)


def _turns(function: Function) -> bool:
    """Tell whether the function exchanges channels by an index."""
    return any("::-1" in ast.unparse(node) or "[2, 1, 0]" in ast.unparse(node) for node in function.of(ast.Subscript))


def _is_observed(image: ast.expr, function: Function, depth: int = 3) -> bool:
    """Tell whether an image comes from an observation or a trajectory."""
    calls = (last(called(node)) for node in ast.walk(image))
    if sdk.Obs.VISION in texts(image) or any(
        name == "get_image" or (name != "imdecode" and decodes(name)) for name in calls
    ):
        return True
    if not depth:
        return False
    mentioned = names(image)
    binds: list[ast.Assign | ast.For] = [*function.of(ast.Assign), *function.of(ast.For)]
    for node in binds:
        value = node.iter if isinstance(node, ast.For) else node.value
        bound = {target.id for target in targets(node) if isinstance(target, ast.Name)}
        if bound & mentioned and not bound & names(value) and _is_observed(value, function, depth - 1):
            return True
    return False
