"""XPL135: The evaluation loop calls only operations of the protocol, reset first."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.loops import ENDS, EXECUTES, OPERATIONS, foreign_attributes, loops, passes_on, policy_calls
from xpl_cli.audit.static.model_class import RESET
from xpl_cli.audit.static.source import Source

_CARRIED = frozenset((sdk.Payload.FUNC_NAME, sdk.Payload.OBS))
"""What a call carries: the operation, and its one argument."""
_CLIENT = frozenset((sdk.Message.CLOSE, "connect"))


@rule(code="XPL135", requirement="XPL-LOOP-3")
def wire_operations(source: Source) -> Iterator[Finding]:
    """The evaluation loop calls an operation that the protocol does not have, or does not call reset first.

    ## What it does
    Collects what the evaluation functions call on the client by `call(func_name=...)`: only operations of the contract
    and the methods that policy.yml declares are allowed; the first one has to be `reset`. A call has one argument,
    `obs`, which also carries the list of environments. Of the environment it looks for attributes that no environment
    of the standard offers.

    ## Why it matters
    A server refuses other names, and a benchmark's client has no other methods. Without a reset the first action of an
    episode depends on the state of the previous one.

    ## Example
    `model_client.call(func_name="set_language", obs=text)`.

    ## Use instead
    Send it with the observation, or declare the method under `methods` in policy.yml.

    ## Fix safety
    No automatic fix.
    """
    operations = {*sdk.CONTRACT_METHODS, *sdk.HOOKS, *source.manifest.methods}
    for function in loops(source):
        foreign = foreign_attributes(function)
        if foreign:
            named = ", ".join(dict.fromkeys(node.attr for node in foreign))
            yield Finding(
                f"{function.name} needs {named} of the environment, which no other environment has: AttributeError",
                **source.at(function.file, foreign[0]),
                expected=", ".join(sorted(OPERATIONS)),
                got=ast.unparse(foreign[0]),
                fix=Fix("advice", f"play the chunk with {EXECUTES[0]}, and read {ENDS[0]}"),
            )
        first: ast.Call | None = None
        for node, name in sorted(policy_calls(function), key=lambda entry: (entry[0].lineno, entry[0].col_offset)):
            is_call = isinstance(node.func, ast.Attribute) and node.func.attr == sdk.Message.CALL
            if name is not None and (name not in operations if is_call else name not in _CLIENT):
                yield Finding(
                    f"the server does not know {name}: {function.name} stops with an error there",
                    **source.at(function.file, node),
                    expected=", ".join(sdk.CONTRACT_METHODS),
                    got=ast.unparse(node)[:80],
                    fix=Fix("advice", "send it with the observation, or declare it under `methods` in policy.yml"),
                )
            for keyword in node.keywords if is_call else ():
                if keyword.arg is not None and keyword.arg not in _CARRIED:
                    yield Finding(
                        f"{sdk.Message.CALL} has no {keyword.arg}: {function.name} raises TypeError there, or a "
                        "lenient client drops it, and the policy never gets it",
                        **source.at(function.file, keyword.value),
                        expected=f"{name or sdk.Message.CALL}(..., {sdk.Payload.OBS}=...)",
                        got=ast.unparse(node)[:80],
                        fix=Fix("advice", f"pass it as {sdk.Payload.OBS}"),
                    )
            if first is None and is_call:
                first = node
                if name is not None and name != RESET and not passes_on(function.node, function, source, 1):
                    yield Finding(
                        f"{function.name} does not reset first: the episode starts with the state of the previous one",
                        **source.at(function.file, node),
                        expected=f"{RESET} before {name}",
                        got=ast.unparse(node)[:80],
                        fix=Fix("advice", f"call {RESET} first"),
                    )
