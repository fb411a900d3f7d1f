"""XPL132: The adapter does not print at every observation or action."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, RESETTING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, is_conditional


@rule(code="XPL132", requirement="XPL-PKG-7")
def print_per_inference(source: Source) -> Iterator[Finding]:
    """The adapter prints at every observation or action.

    ## What it does
    Follows what `update_obs` and `get_action` call unconditionally, and looks for `print`. Prints under a condition,
    and in functions that are called under one, are not reported.

    ## Why it matters
    At 25 Hz with ten environments these are 250 lines per second. They hide the message that matters, and formatting
    arrays and flushing takes a part of the control period.

    ## Example
    `print("request", self.count, action[:6], flush=True)` in `get_action`.

    ## Use instead
    `logging.debug`, or a message at reset.

    ## Fix safety
    No automatic fix.
    """
    for function in _always(ModelClass.of(source)):
        for node in function.nodes:
            if called(node) in {"print", "pprint"} and not is_conditional(node, function.node, function.up):
                yield Finding(
                    f"{function.name} prints at every call: 250 lines a second in ten environments at 25 Hz",
                    **source.start(function.file, node),
                    expected="no output in the control loop",
                    got=ast.unparse(node)[:80],
                    fix=Fix("advice", "use logging.debug, or print at reset"),
                )


def _always(adapter: ModelClass) -> list[Function]:
    """Return the functions that every observation or action runs through."""
    functions = [function for name in (*OBSERVING, *ACTING) if (function := adapter.method(name)) is not None]
    excluded = {id(method.node) for name in (*LOADING, *RESETTING) if (method := adapter.method(name)) is not None}
    visited = {id(function.node) for function in functions}
    for function in functions:
        for node in function.nodes:
            other = adapter.callee(function, node) if isinstance(node, ast.Call) else None
            if (
                other is None
                or id(other.node) in visited | excluded
                or is_conditional(node, function.node, function.up)
            ):
                continue
            visited.add(id(other.node))
            functions.append(other)
    return functions
