"""XPL182: The choice of a file does not depend on the order of a directory listing."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Edit, Finding, Fix, rule
from xpl_cli.audit.static.edits import replace_node, source_segment
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last, targets

_LISTS: Final = frozenset(("listdir", "glob", "iglob", "rglob", "iterdir", "scandir"))
_KEEPS: Final = frozenset(("list", "tuple", "enumerate", "tqdm", "iter"))


@rule(code="XPL182", requirement="XPL-CKP-6")
def file_order(source: Source) -> Iterator[Finding]:
    """The first or last entry of an unsorted directory listing is used.

    ## What it does
    Finds `glob`, `listdir` and `iterdir` of which one entry is selected by position (`[0]`, `[-1]`, `next`), and, in
    the data conversion, loops that number episodes in that order. Sorted lists are not reported.

    ## Why it matters
    The order is that of the file system: another machine, or a copy of the folder, loads another checkpoint. Episodes
    get other numbers, and the split into training and validation data changes.

    ## Example
    `weights = glob.glob(f"{run}/*.pt")[-1]`.

    ## Use instead
    `xpl.checkpoint.resolve`, or `sorted(..., key=...)` by the training step.

    ## Fix safety
    Unsafe: `sorted` gives one of the orders that the file system could have given.
    """
    for file in source.python_files:
        if not any(name in source.text(file) for name in ("glob", "dir(")):
            continue
        is_conversion = file in source.conversion_files
        for function in source.functions(file):
            for call, what in _taken(function, is_conversion=is_conversion):
                yield _finding(source, file, call, what)


def _taken(function: Function, *, is_conversion: bool) -> Iterator[tuple[ast.Call, str]]:
    """Yield listings of a folder that are used by place, with what is done."""
    for call in function.of(ast.Call):
        if last(called(call)) not in _LISTS:
            continue
        node: ast.AST = call
        parent = function.up.get(node)
        while isinstance(parent, ast.Call) and called(parent) in _KEEPS:
            node, parent = parent, function.up.get(parent)
        if _by_place(parent, node):
            yield call, "another machine uses another file"
        elif isinstance(parent, ast.Assign) and parent.value is node:
            names = {target.id for target in targets(parent) if isinstance(target, ast.Name)}
            if not _is_ordered(function, names) and any(
                isinstance(entry, ast.Subscript) and getattr(entry.value, "id", "") in names and _is_end(entry)
                for entry in function.nodes
            ):
                yield call, "another machine uses another file"
        elif is_conversion and isinstance(parent, ast.For) and called(node) == "enumerate":
            yield call, "another machine numbers the episodes differently"


def _by_place(parent: ast.AST | None, node: ast.AST) -> bool:
    if isinstance(parent, ast.Subscript) and parent.value is node:
        return _is_end(parent)
    return isinstance(parent, ast.Call) and called(parent) == "next" and len(parent.args) == 1


def _is_end(node: ast.Subscript) -> bool:
    return isinstance(node.ctx, ast.Load) and constant(node.slice) in {0, -1}


def _is_ordered(function: Function, names: set[str]) -> bool:
    """Tell whether a list is sorted, or its length looked at: then it may hold one entry only."""
    for call in function.of(ast.Call):
        argument_names = {getattr(entry, "id", "") for entry in call.args}
        if last(called(call)) in {"sorted", "max", "min", "natsorted", "len"} and argument_names & names:
            return True
        if (
            isinstance(call.func, ast.Attribute)
            and call.func.attr == "sort"
            and getattr(call.func.value, "id", "") in names
        ):
            return True
    return False


def _finding(source: Source, file: str, call: ast.Call, what: str) -> Finding:
    text = f"sorted({source_segment(source, file, call)})"
    edit: Edit = replace_node(source, file, call, text)
    return Finding(
        f"{last(called(call))} returns files in the order of the file system: {what}",
        **source.at(file, call),
        expected=text,
        got=ast.unparse(call),
        fix=Fix("unsafe_edit", text, (edit,)),
    )
