"""XPL112: Observations without env_idx are assigned by position."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.episode_state import is_reported
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import UPDATE_BATCH, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import LOOPS, KeyRead, called, constant, enclosing, key_read, names, parameters, texts

_KEY = sdk.Obs.ENV_IDX
_FIX = Fix(
    "advice", f"enumerate the batch and use obs.get({_KEY!r}, index) both for the order and for the stored observations"
)


@rule(code="XPL112", requirement="XPL-BAT-4")
def missing_env_index(source: Source) -> Iterator[Finding]:
    """Observations without env_idx overwrite each other, or raise an error.

    ## What it does
    Looks at how `update_obs_batch` and its helpers determine the environment of each observation: a constant default
    stores the whole batch in one slot, and `obs["env_idx"]` raises an error. It also compares the default for the list
    of environments with the default for the stored observations.

    ## Why it matters
    `env_idx` is optional; without it, environments are numbered by position. With one slot for all, every environment
    gets the action of the last one. With two different defaults, the list names environments that have no observation.

    ## Example
    `order = [obs.get("env_idx", i) for i, obs in enumerate(batch)]`, and then `store[obs.get("env_idx", 0)] = obs`.

    ## Use instead
    One loop, `for index, obs in enumerate(batch): env = obs.get("env_idx", index)`, that fills both.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    function = adapter.method(UPDATE_BATCH)
    if function is None or _asks_first(function):
        return
    reads = [
        entry
        for node in function.nodes
        if (entry := key_read(node)) is not None and entry.key == _KEY and _is_in_loop(entry, function)
    ]
    by_position = any(read.default is not None and constant(read.default) is ... for read in reads)
    for read in reads:
        if read.default is not None and isinstance(constant(read.default), int):
            slot = constant(read.default)
            consequence = (
                f"the order is by position but all are stored as environment {slot}: environment 1 is unknown"
                if by_position
                else f"all are stored as environment {slot}: every environment acts on the last observation"
            )
            yield _finding(source, function, read, f"of a batch without {_KEY} {consequence}")
        elif read.required:
            yield _finding(
                source, function, read, f"a batch without {_KEY} raises KeyError, although the key is optional"
            )
    if not _gives(function):
        yield from _in_helpers(source, adapter, function)


def _in_helpers(source: Source, adapter: ModelClass, function: Function) -> Iterator[Finding]:
    """Yield what a helper that is given one observation of the batch after another does without the key."""
    visited: set[int] = set()
    for caller, helper, parameter in _handed(adapter, function, 2):
        if id(helper.node) in visited:
            continue
        visited.add(id(helper.node))
        for choice in _chosen(helper):
            yield Finding(
                f"{caller.name} passes a batch to {helper.name} one by one: without {_KEY} all count as "
                f"environment {constant(choice.orelse)}, and overwrite each other or share one history",
                **source.at(helper.file, choice),
                expected="position in the batch if the key is missing",
                got=ast.unparse(choice),
                fix=_FIX,
            )
        if _asks_first(helper):
            continue
        for node in helper.nodes:
            read = key_read(node)
            if read is None or read.key != _KEY or getattr(read.owner, "id", "") != parameter:
                continue
            if is_reported(node, helper):
                continue
            if isinstance(constant(read.default), int):
                yield _finding(
                    source,
                    helper,
                    read,
                    f"{caller.name} passes a batch to {helper.name} one by one: without {_KEY} all count as "
                    f"environment {constant(read.default)}, and overwrite each other or share one history",
                )
            elif read.required:
                yield _finding(
                    source, helper, read, f"a batch without {_KEY} raises KeyError, although the key is optional"
                )


def _chosen(function: Function) -> list[ast.IfExp]:
    """Return where a constant stands for a key that is missing: `obs["env_idx"] if "env_idx" in obs else 0`."""
    return [
        node
        for node in function.of(ast.IfExp)
        if isinstance(node.test, ast.Compare)
        and isinstance(node.test.ops[0], ast.In)
        and constant(node.test.left) == _KEY
        and isinstance(constant(node.orelse), int)
    ]


def _handed(adapter: ModelClass, function: Function, depth: int) -> Iterator[tuple[Function, Function, str]]:
    """Yield the functions that a loop over the batch gives an observation, with the parameter that takes it."""
    batch = set(parameters(function.node)[:1])
    entries: set[str] = set()
    loops: list[ast.For | ast.comprehension] = [*function.of(ast.For), *function.of(ast.comprehension)]
    for loop in loops:
        if names(loop.iter) & batch:
            entries |= names(loop.target)
    yield from _given(adapter, function, entries, depth)


def _given(
    adapter: ModelClass, function: Function, entries: set[str], depth: int
) -> Iterator[tuple[Function, Function, str]]:
    for call in function.of(ast.Call) if depth and entries else ():
        helper = adapter.callee(function, call)
        if helper is None or helper.node is function.node:
            continue
        taken = list(zip(parameters(helper.node), call.args, strict=False))
        taken += [(entry.arg, entry.value) for entry in call.keywords if entry.arg]
        for parameter, value in taken:
            if isinstance(value, ast.Name) and value.id in entries:
                yield function, helper, parameter
                yield from _given(adapter, helper, {parameter}, depth - 1)


def _gives(function: Function) -> bool:
    """Tell whether the method gives observations the key that they lack."""
    for node in function.of(ast.Dict, ast.Call, ast.Subscript):
        keys: list[ast.expr | None] = []
        if isinstance(node, ast.Dict):
            keys = list(node.keys)
        elif isinstance(node, ast.Subscript):
            keys = [node.slice] if isinstance(node.ctx, ast.Store) else []
        elif isinstance(node, ast.Call):
            keys = list(node.args[:1]) if called(node).endswith("setdefault") else []
            if any(entry.arg == _KEY for entry in node.keywords):
                return True
        if any(constant(key) == _KEY for key in keys):
            return True
    return False


def _finding(source: Source, function: Function, read: KeyRead, message: str) -> Finding:
    return Finding(
        message,
        **source.at(function.file, read.node),
        expected="position in the batch if the key is missing",
        got=ast.unparse(read.node),
        fix=_FIX,
    )


def _is_in_loop(read: KeyRead, function: Function) -> bool:
    return any(isinstance(entry, LOOPS) for entry in enclosing(read.node, function.up))


def _asks_first(function: Function) -> bool:
    """Tell whether the method asks for the key before it relies on it."""
    return any(
        isinstance(node, ast.Compare)
        and (
            (isinstance(node.ops[0], (ast.In, ast.NotIn)) and _KEY in texts(node.left))
            or (isinstance(node.ops[0], (ast.Is, ast.IsNot)) and f"'{_KEY}'" in ast.unparse(node.left))
        )
        for node in function.nodes
    )
