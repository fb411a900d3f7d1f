"""XPL173: Zero is not treated as missing."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.edits import replace_node, source_segment
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, RESETTING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last, names, self_attribute

_VECTORS: Final = re.compile(r"(.*_)?(actions?|states?|qpos|pose|joints?|gripper|proprio|delta)")
_NUMBERS: Final = frozenset(("int", "float"))
_ALL: Final = frozenset(("all", "any", "nonzero", "count_nonzero"))


@rule(code="XPL173", requirement="XPL-ACT-13")
def zero_as_missing(source: Source) -> Iterator[Finding]:
    """A value of exactly zero is treated as missing.

    ## What it does
    Finds settings that `deploy.yml` sets to 0 and that `or` replaces by another number, and actions or states from
    which `all(x != 0)` and its like select the non-zero rows.

    ## Why it matters
    A fully closed gripper is exactly 0, and so are the first step and the first GPU. Rows with such an entry are
    missing from an average; `temperature: 0` runs with 1.

    ## Example
    `populated = torch.all(actions != 0, axis=1)`: one closed gripper removes the prediction from the ensemble.

    ## Use instead
    `is None`, a count of the filled rows, or NaN to mark an empty row.

    ## Fix safety
    `x if x is not None else default` differs from `x or default` for 0, false and the empty string, as intended.
    """
    adapter = ModelClass.of(source)
    yield from _replaced(source, adapter)
    parts = [part.reach(*part.methods.keys() - LOADING) for part in adapter.components.values()]
    reached = [*adapter.reach(*OBSERVING, *ACTING, *RESETTING), *(function for part in parts for function in part)]
    for function in {id(function.node): function for function in reached}.values():
        yield from _selected(source, function)


def _replaced(source: Source, adapter: ModelClass) -> Iterator[Finding]:
    """Yield settings that are 0 and run with another number."""
    for setting in adapter.settings:
        read, function = setting.read, setting.function
        test = function.up.get(read.node)
        while isinstance(test, ast.Call) and called(test) in _NUMBERS:
            test = function.up.get(test)
        if not isinstance(test, ast.BoolOp) or not isinstance(test.op, ast.Or) or read.key == sdk.Deploy.SEED:
            continue
        value, default = source.deploy.get(read.key), constant(test.values[-1])
        if type(value) in {int, float} and value == 0 and type(default) in {int, float} and default != 0:
            first = source_segment(source, function.file, test.values[0])
            instead = f"{default} if {first} is None else {first}"
            is_converted = isinstance(test.values[0], ast.Call) and called(test.values[0]) in _NUMBERS
            edits = () if is_converted else (replace_node(source, function.file, test, f"({instead})"),)
            yield Finding(
                f"{read.key}: 0 is treated as missing: the policy runs with {default}",
                **source.at(function.file, test),
                expected=instead,
                got=ast.unparse(test),
                fix=Fix("unsafe_edit" if edits else "advice", instead, edits),
            )


def _selected(source: Source, function: Function) -> Iterator[Finding]:
    """Yield actions or states of which what holds a zero is left out."""
    for node in function.of(ast.Call):
        if last(called(node)) not in _ALL:
            continue
        values = [*node.args, *([node.func.value] if isinstance(node.func, ast.Attribute) else [])]
        for value in values:
            if _asks_for_zero(value) and _selects(function, node):
                yield Finding(
                    "predictions are dropped if an entry is exactly 0, such as a closed gripper",
                    **source.at(function.file, node),
                    expected="a count of the rows that were filled in, or NaN for the others",
                    got=ast.unparse(node),
                    fix=Fix("advice", "remember which rows were filled in"),
                )


def _asks_for_zero(value: ast.expr) -> bool:
    """Tell whether an expression compares actions or states with zero."""
    if not isinstance(value, ast.Compare) or not isinstance(value.ops[0], (ast.NotEq, ast.Eq)):
        return False
    if constant(value.comparators[0]) != 0:
        return False
    words = names(value.left) | {self_attribute(value.left) or ""}
    return any(_VECTORS.search(word) for word in words)


def _selects(function: Function, node: ast.expr) -> bool:
    """Tell whether a truth value chooses rows: it is an index, as it is or by its name."""
    parent = function.up.get(node)
    if isinstance(parent, ast.Subscript):
        return True
    stored = {target.id for target in getattr(parent, "targets", []) if isinstance(target, ast.Name)}
    return any(names(entry.slice) & stored for entry in function.of(ast.Subscript)) if stored else False
