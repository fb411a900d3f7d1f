"""XPL168: Data conversion does not replace missing values."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.fallbacks import zero_fallbacks
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import constant, names, texts

_MAKERS: Final = frozenset(("zeros", "zeros_like", "full", "new"))
_ACTION, _STATE = "action", sdk.Obs.STATE


@rule(code="XPL168", requirement="XPL-DAT-1")
def conversion_fills_missing(source: Source) -> Iterator[Finding]:
    """Data conversion replaces values that a trajectory lacks by made-up ones.

    ## What it does
    Reads the Python files that `process_data.sh` runs, and looks for zeros that replace a missing camera or value, and
    for the recorded state in place of missing actions. Zeros with a mask in the same branch are not reported.

    ## Why it matters
    One trajectory with a misspelt camera trains the policy on black frames. Actions that are copies of the state train
    it to hold its pose. The loss decreases all the same.

    ## Example
    `if camera not in vision: images[camera] = np.zeros((steps, 240, 320, 3), np.uint8)`.

    ## Use instead
    An error that names the file and the missing value, or skipping the trajectory with a log message.

    ## Fix safety
    No automatic fix: data that was already converted has to be converted again.
    """
    if not source.conversion_files:
        raise NotApplicable("the adapter converts no data")
    for name in source.conversion_files:
        nodes = source.nodes(name) if source.parses(name) else ()
        suspects = [
            node
            for node in nodes
            if (isinstance(node, ast.Attribute) and node.attr in _MAKERS)
            or (isinstance(node, ast.Assign) and _fills_actions(node))
        ]
        for function in source.functions(name) if suspects else ():
            if _around(function.node, suspects):
                yield from _zeros(source, function)
                yield from _copied(source, function)


def _around(function: ast.FunctionDef | ast.AsyncFunctionDef, suspects: Sequence[ast.AST]) -> bool:
    end = function.end_lineno or function.lineno
    return any(function.lineno <= getattr(node, "lineno", 0) <= end for node in suspects)


def _fills_actions(node: ast.Assign) -> bool:
    return any(
        isinstance(target, ast.Subscript) and _is(_ACTION, target) and not _is(_STATE, target)
        for target in node.targets
    )


def _zeros(source: Source, function: Function) -> Iterator[Finding]:
    for blank in zero_fallbacks(function):
        if blank.is_image and not blank.is_masked:
            yield Finding(
                f"{function.name} trains the policy on black frames if {blank.missing} is missing",
                **source.at(function.file, blank.node),
                expected="an error that names the trajectory and what it lacks",
                got=ast.unparse(blank.node),
                fix=Fix("advice", "raise an error, or skip the trajectory with a log message"),
            )
            return


def _copied(source: Source, function: Function) -> Iterator[Finding]:
    """Yield the first place where the state becomes the action because there is none."""
    for node in function.nodes:
        if isinstance(node, ast.Assign) and _fills_actions(node) and _is(_STATE, node.value) and _asks(function, node):
            yield Finding(
                f"{function.name} uses the state as actions if none were recorded: the policy learns to hold its pose",
                **source.at(function.file, node),
                expected="an error that names the trajectory",
                got=ast.unparse(node),
                fix=Fix("advice", "raise an error, or use the next step's state with a log message"),
            )
            return


def _is(group: str, node: ast.AST) -> bool:
    """Tell whether an expression is a look-up in `action` or `state`, by a name or by a key."""
    if isinstance(node, ast.Subscript):
        return constant(node.slice) == group or _is(group, node.value)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get":
        return bool(node.args) and constant(node.args[0]) == group
    return isinstance(node, ast.Name) and node.id == group


def _asks(function: Function, node: ast.AST) -> bool:
    """Tell whether the function asks, before it assigns, whether there is an action."""
    return any(
        isinstance(test, ast.Compare)
        and isinstance(test.ops[0], (ast.In, ast.NotIn))
        and test.lineno <= getattr(node, "lineno", 0)
        and (_ACTION in texts(test) | names(test.comparators[0]))
        for test in function.nodes
    )
