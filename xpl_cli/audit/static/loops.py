"""The evaluation loop of deploy.py: its functions, and their calls of the environment and of the policy."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.audit.static.model_class import UPDATE, UPDATE_BATCH, symbols
from xpl_cli.audit.static.syntax import constant, parameters
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function
    from xpl_cli.audit.static.source import Source

_TASK_ENV: Final = spec.data("package")["task_env"]
EXECUTES: Final = tuple(_TASK_ENV["executes"])
ENDS: Final = tuple(_TASK_ENV["ends"])
OPERATIONS: Final = frozenset(_TASK_ENV["operations"])
UPDATES: Final = (UPDATE, UPDATE_BATCH)


@cache
def function_names() -> tuple[str, ...]:
    """Return the names of the evaluation functions in deploy.py."""
    return tuple(spec.data("package")["loop"]["functions"])


def loops(source: Source) -> list[Function]:
    """Return the evaluation functions that deploy.py defines or imports from another file of the adapter.

    Raises:
        NotRun: if deploy.py does not parse.
    """
    source.tree(sdk.File.DEPLOY_PY)
    functions = symbols(source, sdk.File.DEPLOY_PY).functions
    return [functions[name] for name in function_names() if name in functions]


def policy_calls(function: Function) -> Iterator[tuple[ast.Call, str | None]]:
    """Yield a function's calls of the policy, `call(func_name="reset")`, with the name; None if it is computed."""
    client = _client(function)
    for node in function.nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and _is(node.func.value, client):
            if node.func.attr == sdk.Message.CALL:
                name_arguments = [
                    entry.value for entry in node.keywords if entry.arg == sdk.Payload.FUNC_NAME
                ] or node.args[:1]
                name = constant(name_arguments[0]) if name_arguments else None
                yield node, name if isinstance(name, str) else None
            else:
                yield node, node.func.attr


def environment_calls(node: ast.AST, function: Function, names: tuple[str, ...]) -> Iterator[ast.Call]:
    """Yield calls of these methods of the environment below a node."""
    environment = _environment(function)
    for child in function.nodes if node is function.node else ast.walk(node):
        if not isinstance(child, ast.Call) or not isinstance(child.func, ast.Attribute):
            continue
        if child.func.attr in names and _is(child.func.value, environment):
            yield child


def foreign_attributes(function: Function) -> list[ast.Attribute]:
    """Return what a loop calls or reads of the environment that the standard does not have."""
    environment = _environment(function)
    return [
        node
        for node in function.of(ast.Attribute)
        if _is(node.value, environment) and isinstance(node.ctx, ast.Load) and node.attr not in OPERATIONS
    ]


def sends_observation(node: ast.AST, function: Function) -> bool:
    """Return whether `update_obs` is called below a node."""
    inside = set(map(id, ast.walk(node)))
    return any(id(call) in inside and name in UPDATES for call, name in policy_calls(function))


def passes_on(node: ast.AST, function: Function, source: Source, parameter: int, names: tuple[str, ...] = ()) -> bool:
    """Return whether the environment or the client is passed, below a node, to a function that may call its methods.

    Args:
        node: the node.
        function: the evaluation function.
        source: the adapter.
        parameter: 0 for the environment, 1 for the client.
        names: its methods; a function of the boundary that calls none of them does not count.
    """
    parameter_name = _environment(function) if parameter == 0 else _client(function)
    functions = symbols(source, function.file).functions
    for child in ast.walk(node):
        if isinstance(child, ast.Call) and any(_is(value, parameter_name) for value in child.args):
            other = functions.get(child.func.id) if isinstance(child.func, ast.Name) else None
            if other is None or not names:
                return True
            if any(isinstance(entry, ast.Attribute) and entry.attr in names for entry in other.nodes):
                return True
    return False


def _environment(function: Function) -> str:
    return (parameters(function.node) or [""])[0]


def _client(function: Function) -> str:
    return ([*parameters(function.node), "", ""])[1]


def _is(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name
