"""XPL116: An error in reset is raised."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import RESET, RESETTING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, dotted, enclosing, is_broad, last

_TIDIES = frozenset(("empty_cache", "collect", "synchronize", "is_available", sdk.Message.CLOSE))
"""Calls whose failure leaves no memory of an episode behind."""
_NOTES = frozenset(("print", "log", "debug", "info", "warn", "warning", "error", "exception", "print_exc"))


@rule(code="XPL116", requirement="XPL-EPI-4")
def reset_error_ignored(source: Source) -> Iterator[Finding]:
    """An error in reset is caught and not raised.

    ## What it does
    Looks in `reset`, and in what it calls, for handlers that catch every exception and do not raise.

    ## Why it matters
    The next episode starts with the state of the previous one. A warning in the middle of a hundred episodes goes
    unnoticed; an error ends the run, and the run can be repeated.

    ## Example
    `try: self.server.reset_memory()` with `except Exception: logging.warning(...)`.

    ## Use instead
    Let the exception pass, or raise one that says what to do.

    ## Fix safety
    No automatic fix.
    """
    for function in ModelClass.of(source).reach(*RESETTING):
        for node in function.nodes:
            if isinstance(node, ast.Try):
                for handler in node.handlers:
                    if is_broad(handler) and _goes_on(function, node, handler):
                        yield _finding(source, function, handler, "the error is caught and not raised")
            elif isinstance(node, (ast.With, ast.AsyncWith)) and _suppresses(node):
                yield _finding(source, function, node, "the error is suppressed")


def _finding(source: Source, function: Function, node: ast.AST, got: str) -> Finding:
    return Finding(
        f"an error in {RESET} is hidden: the next episode starts with the state of the previous one",
        **source.start(function.file, node),
        expected="an exception",
        got=got,
        fix=Fix("advice", "let the exception pass, or raise one that says what to do"),
    )


def _goes_on(function: Function, node: ast.Try, handler: ast.ExceptHandler) -> bool:
    """Tell whether a handler does nothing but note the error, and nothing is raised after it either."""
    if any(isinstance(outer, ast.ExceptHandler) for outer in enclosing(node, function.up)):
        return False  # tidying up after another error
    later = [
        entry for entry in function.nodes if isinstance(entry, ast.Raise) and entry.lineno > (handler.end_lineno or 0)
    ]
    only_imports = all(isinstance(entry, (ast.Import, ast.ImportFrom, ast.Pass)) for entry in node.body)
    called_names = {last(called(child)) for entry in node.body for child in ast.walk(entry)} - {""}
    only_tidies = bool(called_names) and called_names <= _TIDIES
    return all(map(_only_notes, handler.body)) and not later and not only_imports and not only_tidies


def _only_notes(statement: ast.stmt) -> bool:
    """Tell whether a statement passes, leaves without a value, prints, logs, or sets a constant."""
    if isinstance(statement, ast.Expr):
        return not isinstance(statement.value, ast.Call) or last(called(statement.value)) in _NOTES
    if isinstance(statement, ast.Assign):
        return isinstance(statement.value, ast.Constant)
    if isinstance(statement, ast.Return):
        return statement.value is None or isinstance(statement.value, ast.Constant)
    return isinstance(statement, (ast.Pass, ast.Continue, ast.Break))


def _suppresses(node: ast.With | ast.AsyncWith) -> bool:
    return any(
        last(called(item.context_expr)) == "suppress"
        and isinstance(item.context_expr, ast.Call)
        and any(last(dotted(entry)) in {"Exception", "BaseException"} for entry in item.context_expr.args)
        for item in node.items
    )
