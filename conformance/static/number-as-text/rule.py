"""XPL183: Step numbers in names are compared as numbers."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import assigned, called, constant, dotted, last, targets, texts

_LISTS: Final = frozenset(("listdir", "glob", "iglob", "rglob", "iterdir"))
_NUMBERED: Final = re.compile(r"(step|epoch|checkpoint|ckpt|iter|global_step)s?\W?[-_]?(\*|=|$)|\.ckpt$|\*\.pth?$")
_PADDED: Final = re.compile(r"0\d+d|zfill|:0")


@rule(code="XPL183", requirement="XPL-CKP-6")
def number_as_text(source: Source) -> Iterator[Finding]:
    """The latest checkpoint is chosen by comparing names as strings.

    ## What it does
    Finds folders or files whose names contain a step or epoch number, and of which the last is selected after `sorted`,
    `.sort` or `max` without a key.

    ## Why it matters
    As a string, step_9000 comes after step_10000. The run evaluates a checkpoint from long before the end of training,
    without an error.

    ## Example
    `sorted(run.glob("step_*"))[-1]`.

    ## Use instead
    `xpl.checkpoint.resolve`, or `max(run.glob("step_*"), key=lambda path: int(path.name.rpartition("_")[2]))`.

    ## Fix safety
    No automatic fix: only the author knows where the number stands in the name.
    """
    for file in source.python_files:
        if any(name in source.text(file) for name in ("glob", "dir(")):
            for function in source.functions(file):
                yield from _in_function(source, function)


def _in_function(source: Source, function: Function) -> Iterator[Finding]:
    values = assigned(function.of(ast.Assign))
    for call in function.of(ast.Call):
        name = called(call)
        if name not in {"sorted", "max"} or len(call.args) != 1 or any(entry.arg == "key" for entry in call.keywords):
            continue
        listing = _listing(call.args[0], values)
        if listing is None or (name == "sorted" and not _last_of(call, function)):
            continue
        yield Finding(
            "the latest checkpoint is chosen by comparing strings: step 9000 comes after step 10000",
            **source.at(function.file, call),
            expected=f"{name}(..., key=...) by the number",
            got=ast.unparse(call)[:80],
            fix=Fix("advice", "compare the numbers: key=lambda name: int(...)"),
        )


def _listing(node: ast.expr, values: dict[str, ast.expr]) -> ast.Call | None:
    """Return the call that lists names with the number of a step."""
    value = values.get(node.id, node) if isinstance(node, ast.Name) else node
    inner = tuple(ast.walk(value))
    if any(called(call) in {"int", "float"} for call in inner):
        return None  # they are numbers already
    for call in inner:
        if isinstance(call, ast.Call) and last(called(call)) in _LISTS:
            patterns = texts(value)
            if any(_NUMBERED.search(text) for text in patterns) and not any(_PADDED.search(text) for text in patterns):
                return call
    return None


def _last_of(call: ast.Call, function: Function) -> bool:
    """Tell whether the last entry is taken: directly, by the list's name, or the first of a list that is reversed."""
    is_reversed = any(entry.arg == "reverse" and constant(entry.value) is True for entry in call.keywords)
    index = 0 if is_reversed else -1
    parent = function.up.get(call)
    if isinstance(parent, ast.Subscript):
        return constant(parent.slice) == index
    names = {dotted(target) for target in targets(parent)} if isinstance(parent, ast.Assign) else set()
    return any(dotted(entry.value) in names and constant(entry.slice) == index for entry in function.of(ast.Subscript))
