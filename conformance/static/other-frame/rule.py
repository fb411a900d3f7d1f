"""XPL705: A pose is commanded in the frame in which it was observed."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import constant, key_read

_FRAMES: Final = {sdk.State.EE_POSE: "the flange", sdk.State.TCP_POSE: "the tool's tip"}


@rule(code="XPL705", requirement="XPL-ACT-14")
def other_frame(source: Source) -> Iterator[Finding]:
    """The adapter observes one frame of the hand and commands another one.

    ## What it does
    Looks at which of `ee_pose` and `tcp_pose` the adapter reads from observations, and which it writes into actions.
    It reports an adapter that reads one, if need be with the other as a default, and writes the other only. It is a
    warning, since code may apply the transform between the two.

    ## Why it matters
    The two frames differ by the length of the tool. Targets that are made from the observed pose, and weights that were
    trained on it, are off by as much: a gripper closes above the object, or runs into the table.

    ## Example
    `base = state["tcp_pose"]`, and `{"ee_pose": base + delta}`.

    ## Use instead
    `state["ee_pose"]`.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    if adapter.is_sdk:
        return
    functions = adapter.reach(*OBSERVING, *ACTING)
    read = {frame: at for function in functions for frame, at in _read(function)}
    written = {frame: at for function in functions for frame, at in _written(function)}
    if len(read) == 1 and len(written) == 1 and read.keys() != written.keys():
        ((seen, (function, node)),) = read.items()
        (commanded,) = written
        yield Finding(
            f"{_FRAMES[seen]} is observed and {_FRAMES[commanded]} is commanded: targets are off by the length of the "
            "tool, unless the model's own code converts between the two",
            **source.at(function.file, node),
            expected=commanded,
            got=ast.unparse(node)[:80],
            fix=Fix("advice", f"read {commanded}, or convert by the transform of the tool"),
            must=False,
        )


def _frame(key: object) -> str | None:
    return next((frame for frame in _FRAMES if isinstance(key, str) and key.endswith(frame)), None)


def _read(function: Function) -> Iterator[tuple[str, tuple[Function, ast.expr]]]:
    reads = [read for node in function.of(ast.Subscript, ast.Call) if (read := key_read(node)) is not None]
    defaults = {id(child) for read in reads if read.default is not None for child in ast.walk(read.default)}
    for read in reads:
        if id(read.node) not in defaults and (frame := _frame(read.key)) is not None:
            yield frame, (function, read.node)


def _written(function: Function) -> Iterator[tuple[str, ast.AST]]:
    for node in function.of(ast.Dict):
        yield from ((frame, node) for key in node.keys if (frame := _frame(constant(key))) is not None)
    for entry in function.of(ast.Subscript):
        if isinstance(entry.ctx, ast.Store) and (frame := _frame(constant(entry.slice))) is not None:
            yield frame, entry
