"""XPL707: A state is normalised by statistics of states, an action by those of actions."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, last, names, texts

_KINDS: Final = {
    "state": re.compile(r"state|proprio|qpos", re.IGNORECASE),
    "action": re.compile(r"action", re.IGNORECASE),
}
_STATISTICS: Final = re.compile(r"stat(?:istic)?s?$|mean|std|min|max|q01|q99|norm|scale", re.IGNORECASE)
_NORMALISES: Final = re.compile(r"norm", re.IGNORECASE)


@rule(code="XPL707", requirement="XPL-ACT-12")
def statistics_mixed(source: Source) -> Iterator[Finding]:
    """A state is normalised by the statistics of actions, or an action by those of states.

    ## What it does
    Looks, in what observations and actions pass through, for calls of functions that normalise and for arithmetic with
    statistics, where the value is named after a state and the statistics are named after actions, or the other way
    round. It is a warning: some models normalise both by one set.

    ## Why it matters
    Both have the same length, and nothing fails. The model sees joints that are shifted and grippers that are not
    scaled, or the robot goes where the numbers of another distribution send it.

    ## Example
    `normalize(proprio, stats["action"])`.

    ## Use instead
    `normalize(proprio, stats["proprio"])`.

    ## Fix safety
    No automatic fix.
    """
    for function in ModelClass.of(source).reach(*OBSERVING, *ACTING):
        for node, value, statistics in _normalised(function):
            kinds = _kind(value), _kind(statistics)
            if None not in kinds and kinds[0] != kinds[1]:
                yield Finding(
                    f"the {kinds[0]} is normalised by statistics of the {kinds[1]}",
                    **source.at(function.file, node),
                    expected=f"statistics of the {kinds[0]}",
                    got=ast.unparse(node)[:80],
                    fix=Fix("advice", f"take the statistics of the {kinds[0]}"),
                    must=False,
                )
                break


def _normalised(function: Function) -> Iterator[tuple[ast.expr, ast.expr, ast.expr]]:
    """Yield calls and arithmetic with the value that is normalised and what it is normalised by."""
    for call in function.of(ast.Call):
        given = [*call.args, *(keyword.value for keyword in call.keywords)]
        if _NORMALISES.search(last(called(call))) and len(given) > 1:
            yield from ((call, given[0], other) for other in given[1:])
    for node in function.of(ast.BinOp):
        if isinstance(node.op, (ast.Sub, ast.Div, ast.Mult)) and _is_statistic(node.right):
            yield node, node.left, node.right


def _is_statistic(node: ast.expr) -> bool:
    return any(map(_STATISTICS.search, _words(node)))


def _words(node: ast.expr) -> set[str]:
    attributes = {child.attr for child in ast.walk(node) if isinstance(child, ast.Attribute)}
    return names(node) | texts(node) | attributes


def _kind(node: ast.expr) -> str | None:
    found = [kind for kind, pattern in _KINDS.items() if any(map(pattern.search, _words(node)))]
    return found[0] if len(found) == 1 else None
