"""XPL124: A value that is missing from the model's output is an error."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.fallbacks import ZeroFallback, zero_fallbacks
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, dotted, last

_INFERS: Final = re.compile(
    r"^(generate|forward|(predict|infer|sample|denoise|select_action|get_action)(_\w+)?|inference)$"
    r"|(^|_)(model|policy|network|net|vla|transformer|expert|actor)$"
)
"""Last part of the name of a call that runs a model."""
_DEPTH: Final = 2


@rule(code="XPL124", requirement="XPL-ACT-11")
def zero_action(source: Source) -> Iterator[Finding]:
    """A value that is missing from the model's output is replaced by zeros.

    ## What it does
    Looks in the functions that only `get_action` reaches for zeros that replace the result of a failed look-up. Not
    reported: zeros in what a model is then given, such as noise or a placeholder for the actions to generate.

    ## Why it matters
    All joints at zero is a pose like any other. A checkpoint with other key names sends the arm there at full speed.

    ## Example
    `action.get("left_arm", np.zeros((horizon, 6)))`.

    ## Use instead
    `action["left_arm"]`, which raises a KeyError.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    observing = {id(function.node) for function in adapter.reach(*OBSERVING)}
    for function in adapter.reach(*ACTING):
        if id(function.node) in observing:
            continue
        for blank in zero_fallbacks(function):
            if blank.is_image or blank.is_masked or not _is_output(blank.read):
                continue
            if not _is_given_to_model(adapter, blank):
                yield Finding(
                    f"if the model's output lacks {blank.missing}, the robot is sent to zero",
                    **source.at(function.file, blank.node),
                    expected="an error that names the missing key",
                    got=ast.unparse(blank.node),
                    fix=Fix("advice", "read the key with [...], or raise an error"),
                )


def _is_output(name: str) -> bool:
    """Tell whether a map can be what a model answered: no observation, nothing that the adapter stored."""
    words = name.lower().split("_")
    observation_words = {sdk.Obs.STATE, sdk.Payload.OBS, "observation", "self", "cfg", "config"}
    return (
        bool(name) and not name.endswith("()") and not name.startswith("self.") and not observation_words & set(words)
    )


def _is_given_to_model(adapter: ModelClass, blank: ZeroFallback) -> bool:
    """Tell whether a model gets the zeros: by themselves, or as an entry of the map that lacked them.

    A map that a model answered is an output, even if another model gets it afterwards.
    """
    function = blank.function
    if any(dotted(target) == blank.read and _runs_model(value) for target, value in function.assignments):
        return False
    for outer in _outer(blank.node, function):
        if _runs_model(outer):
            return True  # the zeros stand in the call itself
    received = {blank.read}
    received |= {_root(target) for target, value in function.assignments if blank.node in ast.walk(value)}
    return any(_reaches_model(adapter, function, name, _DEPTH) for name in received if name)


def _reaches_model(adapter: ModelClass, function: Function, name: str, depth: int) -> bool:
    """Tell whether a model gets what a name holds, in its function or in one that calls it for its result."""
    for call in function.of(ast.Call):
        arguments = [*call.args, *(keyword.value for keyword in call.keywords)]
        if _runs_model(call) and any(_holds(argument, name) for argument in arguments):
            return True
    returns = any(node.value is not None and _holds(node.value, name) for node in function.of(ast.Return))
    if not returns or depth == 0:
        return False
    for caller in adapter.reach(*ACTING):
        for call in caller.of(ast.Call):
            if adapter.callee(caller, call) is not function:
                continue
            if any(_runs_model(outer) for outer in _outer(call, caller)):
                return True
            results = [_root(target) for target, value in caller.assignments if value is call]
            if any(_reaches_model(adapter, caller, result, depth - 1) for result in results if result):
                return True
    return False


def _holds(argument: ast.expr, name: str) -> bool:
    """Tell whether an argument is what a name holds, an entry of a map in place, or a conversion of it."""
    if isinstance(argument, ast.Call):
        return any(_holds(value, name) for value in argument.args) or (
            isinstance(argument.func, ast.Attribute) and _holds(argument.func.value, name)
        )
    if isinstance(argument, ast.Dict):
        return any(_holds(value, name) for value in argument.values)
    if isinstance(argument, ast.Starred):
        return _holds(argument.value, name)
    return dotted(argument) == name


def _outer(node: ast.AST, function: Function) -> Iterator[ast.Call]:
    """Yield the calls around an expression, nearest first, up to its statement."""
    while node in function.up and not isinstance(node, ast.stmt):
        node = function.up[node]
        if isinstance(node, ast.Call):
            yield node


def _runs_model(node: ast.AST) -> bool:
    while isinstance(node, (ast.Await, ast.Subscript, ast.Attribute)):
        node = node.value
    name = called(node)
    return not name.startswith("super") and _INFERS.search(last(name)) is not None


def _root(target: ast.expr) -> str:
    """Return the variable of an assignment's target: `inputs` of `inputs["noise"]`."""
    while isinstance(target, ast.Subscript):
        target = target.value
    return dotted(target)
