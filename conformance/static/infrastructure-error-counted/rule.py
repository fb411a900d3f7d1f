"""XPL181: An infrastructure error does not count as a failure of the policy."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.static.model_class import symbols
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, dotted, is_broad, last
from xpl_cli.standard import spec

_ENDS: Final = frozenset(("exit", "_exit", "abort"))
_CLIENT: Final = frozenset((sdk.Message.CALL, *sdk.CONTRACT_METHODS))


@rule(code="XPL181", requirement="XPL-LOOP-9")
def infrastructure_error_counted(source: Source) -> Iterator[Finding]:
    """The evaluation loop catches an infrastructure error, and the episode counts as a failure of the policy.

    ## What it does
    Looks in what the evaluation functions of deploy.py reach for handlers that catch every exception around a call of
    the policy or of the environment and do not raise again: the loop continues, or the episode ends without an error.

    ## Why it matters
    A crashed server, a misspelt key and a full disk then look like a policy that cannot do the task. The success rate
    decreases, and the wrong number is published.

    ## Example
    `except Exception as error: print(error); break` around `model_client.call(...)`.

    ## Use instead
    Let it raise: the runner reports an infrastructure error, not a failed episode. Catch only expected exceptions, by
    type.

    ## Fix safety
    No automatic fix: the runner has to handle the error.
    """
    source.tree(sdk.File.DEPLOY_PY)
    defined = symbols(source, sdk.File.DEPLOY_PY).functions
    package = spec.data("package")
    executes = _CLIENT | set(package["task_env"]["operations"])
    functions = [defined[name] for name in package["loop"]["functions"] if name in defined]
    if not functions:
        raise NotRun(f"{sdk.File.DEPLOY_PY} defines no evaluation function")
    reached = {function.name for function in functions}
    for function in functions:
        for call in function.of(ast.Call):
            name = dotted(call.func)
            if name in defined and name not in reached:
                reached.add(name)
                functions.append(defined[name])
    for function in functions:
        for node in function.of(ast.Try):
            operation = next(
                (last(called(call)) for entry in node.body for call in ast.walk(entry) if _asks(call, executes)), None
            )
            for handler in node.handlers if operation else ():
                if is_broad(handler) and not _hands_on(handler):
                    yield Finding(
                        f"when {operation} fails, {function.name} continues without an error: an infrastructure "
                        "error counts as a failure of the policy",
                        **source.start(function.file, handler),
                        expected="an exception that reaches the runner",
                        got=ast.unparse(handler).replace("\n", " ")[:80],
                        fix=Fix("advice", "raise again, or catch one expected type only"),
                    )


def _asks(node: ast.AST, executes: set[str] | frozenset[str]) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in executes


def _hands_on(handler: ast.ExceptHandler) -> bool:
    """Tell whether a handler raises, ends the process, or asks again."""
    return any(
        isinstance(node, ast.Raise) or (isinstance(node, ast.Call) and last(called(node)) in _ENDS)
        for entry in handler.body
        for node in ast.walk(entry)
    )
