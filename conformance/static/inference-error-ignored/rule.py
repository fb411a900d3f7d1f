"""XPL146: An error during inference is raised."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.episode_state import only_reports
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, RESETTING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, is_broad, last, self_attribute, targets

_SIDE = frozenset(
    (
        *("print", "log", "debug", "info", "warning", "error", "exception", "print_exc", "save", "write", "imwrite"),
        *("dump", "savez", "savetxt", "makedirs", "mkdir", "empty_cache", "synchronize", "collect", "open"),
        *("is_available", "item", "decode", "tolist", "strip", "append", "str", "int", "float", "is_tensor", "join"),
        *("isinstance", sdk.Message.CLOSE),
    )
)
"""Calls whose failure leaves the action as it is: records, messages, conversions of a single value."""


@rule(code="XPL146", requirement="XPL-CON-6")
def inference_error_ignored(source: Source) -> Iterator[Finding]:
    """An error during inference is caught, and an action is returned all the same.

    ## What it does
    Looks in what `update_obs` and `get_action` reach for handlers that catch every exception of the model or of the
    adapter's own functions and continue: with another value, with the previous one, or without one. Not reported:
    handlers that raise, that retry, or that only protect logging.

    ## Why it matters
    The robot executes an action that was not computed from an observation. Out of memory, a wrong shape and a missing
    camera all end as an unsuccessful episode, and the benchmark counts an infrastructure error as a failure of the
    method.

    ## Example
    `try: chunk = self.policy.infer(obs)` with `except Exception: chunk = self.last_chunk`.

    ## Use instead
    Let the exception pass. The server reports it to the client with its stack.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    excluded = {id(function.node) for function in adapter.reach(*LOADING, *RESETTING)}
    for name in OBSERVING:
        if (method := adapter.method(name)) is not None:
            yield from _skipped(source, method)
    for function in adapter.reach(*OBSERVING, *ACTING):
        for node in function.of(ast.Try) if id(function.node) not in excluded else ():
            risky = _risky(node.body)
            for handler in node.handlers:
                if risky and is_broad(handler) and (instead := _instead(handler, node, function)) is not None:
                    yield Finding(
                        f"when {risky[0]} fails, {function.name} continues with {instead}: the robot moves "
                        "although the model returned no action",
                        **source.start(function.file, handler),
                        expected="an exception",
                        got=ast.unparse(handler).split("\n")[0] + " ... " + instead,
                        fix=Fix("advice", "delete the handler, or raise in it"),
                    )


def _skipped(source: Source, function: Function) -> Iterator[Finding]:
    """Yield handlers of an observation that drop it without an error: the policy acts on the one before."""
    for node in function.of(ast.Try):
        risky = _risky(node.body)
        for handler in node.handlers:
            inside = [child for entry in handler.body for child in ast.walk(entry)]
            is_left = isinstance(handler.body[-1], (ast.Return, ast.Continue, ast.Pass)) or all(
                map(only_reports, handler.body)
            )
            is_told = any(isinstance(child, (ast.Raise, ast.Assign, ast.AugAssign)) for child in inside)
            if risky and is_left and not is_told:
                yield Finding(
                    f"an observation with which {risky[0]} fails is dropped: the policy acts on the one before it",
                    **source.start(function.file, handler),
                    expected="an exception",
                    got=ast.unparse(handler).split("\n")[0],
                    fix=Fix("advice", "delete the handler, or raise in it"),
                )


def _risky(body: list[ast.stmt]) -> list[str]:
    """Return the calls of a block whose results actions are made of, as they are written."""
    calls = [node for entry in body for node in ast.walk(entry) if isinstance(node, ast.Call)]
    return [called(node) for node in calls if called(node) and last(called(node)) not in _SIDE and _has_use(node, body)]


def _has_use(call: ast.Call, body: list[ast.stmt]) -> bool:
    """Tell whether a call's result is kept or returned, or it is a method of the adapter."""
    if called(call).startswith("self."):
        return True
    return any(
        isinstance(entry, (ast.Assign, ast.Return, ast.AnnAssign)) and any(child is call for child in ast.walk(entry))
        for statement in body
        for entry in ast.walk(statement)
    ) and not called(call).startswith(("np.", "os.", "json.", "time."))


def _instead(handler: ast.ExceptHandler, node: ast.Try, function: Function) -> str | None:
    """Return what a handler goes on with, or None if it raises or tries again."""
    inside = [child for entry in handler.body for child in ast.walk(entry)]
    if any(isinstance(child, ast.Raise) or last(called(child)) in {"exit", "_exit"} for child in inside):
        return None
    tried = {last(name) for name in _risky(node.body)}
    if any(last(called(child)) in tried or last(called(child)) in {"getattr", "retry"} for child in inside):
        return None
    assigned = {ast.unparse(target) for entry in node.body for target in targets(entry)}
    for entry in handler.body:
        if isinstance(entry, ast.Return):
            return ast.unparse(entry.value) if entry.value is not None else "nothing"
        if isinstance(entry, ast.Assign) and {ast.unparse(target) for target in targets(entry)} & assigned:
            return ast.unparse(entry.value)
    records = all(
        isinstance(entry, (ast.Pass, ast.Continue))
        or (isinstance(entry, ast.Expr) and last(called(entry.value)) in _SIDE)
        for entry in handler.body
    )
    return "what was there before" if records and _is_used_later(node, function) else None


def _is_used_later(node: ast.Try, function: Function) -> bool:
    """Tell whether what a block sets is used after it, or kept in the model; a record that is written is not."""
    inside = {id(child) for child in ast.walk(node)}
    bound = [target for entry in node.body for child in ast.walk(entry) for target in targets(child)]
    names = {target.id for target in bound if isinstance(target, ast.Name)}
    if any(isinstance(target, (ast.Attribute, ast.Subscript)) and _is_kept(target) for target in bound):
        return True
    return any(
        name.id in names and isinstance(name.ctx, ast.Load) and id(name) not in inside and name.lineno > node.lineno
        for name in function.of(ast.Name)
    )


def _is_kept(target: ast.expr) -> bool:
    """Tell whether a target is an attribute that is no count of requests."""
    attribute = self_attribute(target)
    return attribute is not None and not any(word in attribute for word in ("count", "log", "debug", "time"))
