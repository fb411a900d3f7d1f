"""XPL106: Clients can call the operations with the arguments of the standard."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.model_class import ACT, ACT_BATCH, RESET, UPDATE, UPDATE_BATCH, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import FunctionNode

# How many positional arguments a client gives: fewest and most.
_GIVEN = {"__init__": (1, 1), UPDATE: (1, 1), UPDATE_BATCH: (1, 1), ACT: (0, 0), ACT_BATCH: (0, 1), RESET: (0, 0)}


@rule(code="XPL106", requirement="XPL-CON-3")
def signatures(source: Source) -> Iterator[Finding]:
    """A client cannot call an operation with the arguments of the standard.

    ## What it does
    Compares the parameters of the operations and of the constructor with the arguments that clients and the server
    pass. Further parameters are allowed if they have defaults.

    ## Why it matters
    Clients call `reset()` without arguments, and `get_action_batch()` with a list or without. A method that requires
    more raises a TypeError at the first call.

    ## Example
    `def reset(self, env_idx)`: the client's `reset` fails before the first episode.

    ## Use instead
    `def reset(self)`, `def get_action(self)`, `def get_action_batch(self, env_idx_list=None)`.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    for name, (fewest, most) in _GIVEN.items():
        function = adapter.method(name)
        if function is None:
            continue
        required, allowed = _accepts(function.node)
        failing = [count for count in sorted({fewest, most}) if not required <= count <= allowed]
        if failing:
            calls = " and ".join(_call(name, count) for count in failing)
            takes = f"{required} to {allowed}" if allowed != required else str(required)
            ends = "" if len(failing) > 1 else "s"
            yield Finding(
                f"{name} takes {takes} positional arguments, so {calls} raise{ends} TypeError",
                **source.start(function.file, function.node),
                expected=calls,
                got=f"def {name}({ast.unparse(function.node.args)})",
                fix=Fix("advice", "give the other parameters defaults, or remove them"),
            )


def _accepts(function: FunctionNode) -> tuple[int, float]:
    """Return how many arguments a bound method needs and takes; a keyword-only one without default counts as needed."""
    arguments = function.args
    is_static = any(getattr(entry, "id", "") == "staticmethod" for entry in function.decorator_list)
    positional = len(arguments.posonlyargs) + len(arguments.args) - (not is_static)
    required = positional - len(arguments.defaults) + sum(default is None for default in arguments.kw_defaults)
    return max(required, 0), float("inf") if arguments.vararg else max(positional, 0)


def _call(name: str, count: int) -> str:
    what = sdk.MODEL_CLASS if name == "__init__" else name
    return f"{what}({'...' if count else ''})"
