"""XPL144: What an adapter takes from the first observation is forgotten at reset."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import ACTING, OBSERVING, RESETTING, Adapter
from xpl_cli.audit.static.episode import is_memo, mentioned, read
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, last, names, parameters, targets

_ABOUT_SIZE = frozenset(("shape", "ndim", "dtype", "device", "size"))


@rule(code="XPL144", requirement="XPL-EPI-1")
def first_episode_kept(source: Source) -> Iterator[Finding]:
    """What the first observation of all set is kept for every later episode.

    ## What it does
    Looks for attributes that are set only while they are empty (`if self.task is None:`), to something made of an
    observation, and that reset does not name. Shapes, types and devices do not count: they stay.

    ## Why it matters
    The second episode runs with the instruction, the first image or the starting pose of the first one. Its actions
    answer another task, and which one depends on the order of the episodes.

    ## Example
    `if self.instruction is None: self.instruction = obs["instruction"]`, and a `reset` that does not clear it.

    ## Use instead
    Read it from every observation; or set it to None in `reset`.

    ## Fix safety
    Setting it to None in `reset` is safe.
    """
    adapter = Adapter.of(source)
    functions = adapter.reach(*OBSERVING, *ACTING)
    resetting = adapter.reach(*RESETTING)
    if not adapter.is_closed and not resetting:
        return
    forgotten = mentioned(resetting)
    found = [write for function in functions for write in function.writes]
    observing = {id(function.node) for function in adapter.reach(*OBSERVING)}
    for write in found:
        if write.kind != "assigned" or write.attribute in forgotten or not is_memo(write):
            continue
        others = [other for other in found if other.attribute == write.attribute and not is_memo(other)]
        value = getattr(write.node, "value", None)
        if others or id(write.function.node) not in observing or not isinstance(value, ast.expr):
            continue
        if _is_observed(value, write.function) and write.attribute in read(functions):
            yield Finding(
                f"self.{write.attribute} is taken from the first observation of all and kept: "
                "every later episode acts on that of the first one",
                **source.at(write.function.file, write.node),
                expected="reset sets it to None",
                got=ast.unparse(write.node).split("\n")[0],
                fix=Fix("advice", f"set self.{write.attribute} = None in reset"),
            )


def _is_observed(value: ast.expr, function: Function) -> bool:
    """Tell whether a value holds something that was observed, not only its size or type."""
    observed = set(parameters(function.node)) - {"env", sdk.Obs.ENV_IDX, "index"}
    for _ in range(2):
        for node in function.of(ast.Assign):
            if names(node.value) & observed and not _is_size(node.value):
                observed |= {target.id for target in targets(node) if isinstance(target, ast.Name)}
    return bool(names(value) & observed) and not _is_size(value)


def _is_size(value: ast.expr) -> bool:
    return any(
        (isinstance(node, ast.Attribute) and node.attr in _ABOUT_SIZE) or last(called(node)) in {"len", "isinstance"}
        for node in ast.walk(value)
    )
