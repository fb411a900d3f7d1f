"""XPL111: An environment that was never observed is an error."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACT_BATCH, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import constant, dotted, last, self_attribute, targets


@rule(code="XPL111", requirement="XPL-BAT-3")
def unknown_environment(source: Source) -> Iterator[Finding]:
    """An environment without an observation gets the action of another one.

    ## What it does
    Follows `get_action_batch` and looks for look-ups by environment whose fallback is another stored observation.

    ## Why it matters
    A client that requests the wrong environment has a bug, and should get an error. Instead one robot gets the command
    for another.

    ## Example
    `self.observations.get(env, self.latest)`: environment 5 gets an action for the last observation of environment 3.

    ## Use instead
    `self.observations[env]`, which raises, or a check with a clear error.

    ## Fix safety
    No automatic fix.
    """
    for function in ModelClass.of(source).reach(ACT_BATCH):
        for node, instead in _fallbacks(function):
            yield Finding(
                f"an environment without an observation gets the action for {ast.unparse(instead)}: "
                f"{ACT_BATCH}([5]) sends robot 5 a command for another one",
                **source.at(function.file, node),
                expected="an error that names the unknown environment",
                got=ast.unparse(node).split("\n")[0],
                fix=Fix("advice", "look the environment up with [...], or raise an error"),
            )


def _fallbacks(function: Function) -> Iterator[tuple[ast.AST, ast.expr]]:
    """Yield look-ups by environment in a stored map, with what stands in for a missing entry."""
    for node in function.nodes:
        if isinstance(node, ast.Call) and len(node.args) == 2 and _is_lookup(node) and _is_stored(node.args[1]):
            yield node, node.args[1]
        elif isinstance(node, ast.BoolOp) and isinstance(node.op, ast.Or):
            first, second = node.values[:2]
            if isinstance(first, ast.Call) and len(first.args) == 1 and _is_lookup(first) and _is_stored(second):
                yield node, second
        elif isinstance(node, ast.IfExp) and isinstance(node.test, ast.Compare):
            container = node.test.comparators[0]
            if isinstance(node.test.ops[0], ast.In) and self_attribute(container) and _is_stored(node.orelse):
                yield node, node.orelse
        elif isinstance(node, ast.Try):
            yield from _caught(node)


def _caught(node: ast.Try) -> Iterator[tuple[ast.AST, ast.expr]]:
    looked_up = any(
        isinstance(child, ast.Subscript) and self_attribute(child) and constant(child.slice) is ...
        for entry in node.body
        for child in ast.walk(entry)
    )
    for handler in node.handlers if looked_up else []:
        if handler.type is not None and last(dotted(handler.type)) == "KeyError":
            for entry in handler.body:
                if isinstance(entry, ast.Assign) and targets(entry) and _is_stored(entry.value):
                    yield entry, entry.value


def _is_lookup(call: ast.Call) -> bool:
    is_get = isinstance(call.func, ast.Attribute) and call.func.attr == "get"
    return is_get and self_attribute(call.func) is not None and constant(call.args[0]) is ...


def _is_stored(node: ast.expr) -> bool:
    """Tell whether a fallback is what the adapter kept of something else: an attribute, or an entry of one."""
    return isinstance(node, (ast.Attribute, ast.Subscript)) and self_attribute(node) is not None
