"""XPL113: Environments of a batch share no episode state."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.episode_state import is_memo, read_attributes
from xpl_cli.audit.static.function import Function, Write, writes
from xpl_cli.audit.static.model_class import ACT_BATCH, UPDATE_BATCH, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import LOOPS, parameters


@rule(code="XPL113", requirement="XPL-BAT-5")
def shared_rollout(source: Source) -> Iterator[Finding]:
    """Environments of a batch share one history, queue or counter.

    ## What it does
    Finds the loops over environments in the batch operations, follows the calls in them, and looks for attributes that
    grow there (`append`, `+=`, ...), are not stored per environment, and are read again.

    ## Why it matters
    Environment 7 then continues the history of environment 3: its chunk is taken from the other's queue, its step
    counter runs twice as fast. The mistake does not show with one environment.

    ## Example
    `for env in env_idx_list: self.update_obs(...); chunks.append(self.get_action())`, where `get_action` keeps a queue
    of pending actions.

    ## Use instead
    Derive from `xpl.Policy` and store state in dicts by environment, or refuse batches.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    for name in (UPDATE_BATCH, ACT_BATCH):
        function = adapter.method(name)
        loop = _loop(adapter, function) if function is not None else None
        if function is None or loop is None:
            continue
        shared = _shared(adapter, function, loop)
        if shared:
            attributes = ", ".join(
                f"self.{attribute}" for attribute in dict.fromkeys(write.attribute for write in shared)
            )
            first = shared[0]
            yield Finding(
                f"the environments of a batch share {attributes}: environment 7 continues where 3 stopped",
                **source.start(function.file, loop),
                expected="state per environment, such as self.history[env]",
                got=f"{ast.unparse(first.node).splitlines()[0]} in {first.function.name}, line {first.line}",
                fix=Fix("advice", "store it in a dict by environment index, cleared at reset"),
            )
            return


def _loop(adapter: ModelClass, function: Function) -> ast.AST | None:
    """Return the loop over environments or observations that a batch operation runs."""
    parameter_names = parameters(function.node)
    for node in function.nodes:
        if isinstance(node, LOOPS) and not isinstance(node, ast.While):
            iterated = (
                [node.iter] if isinstance(node, (ast.For, ast.AsyncFor)) else [entry.iter for entry in node.generators]
            )
            if any(
                isinstance(child, ast.Name) and child.id in parameter_names[:1]
                for entry in iterated
                for child in ast.walk(entry)
            ) and any(
                isinstance(child, ast.Attribute) and getattr(child.value, "id", "") == "self"
                for child in ast.walk(node)
            ):
                return node
    return None


def _shared(adapter: ModelClass, function: Function, loop: ast.AST) -> list[Write]:
    inside = set(map(id, ast.walk(loop)))
    called = [
        adapter.methods[node.attr]
        for node in ast.walk(loop)
        if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "self" and node.attr in adapter.methods
    ]
    reached = [
        other for other in adapter.reach_from(*called) if other.name not in {function.name, UPDATE_BATCH, ACT_BATCH}
    ]
    everything = [*reached, function]
    used = read_attributes(everything)
    return [
        write
        for write in writes(everything)
        if write.kind == "grown"
        and write.attribute in used
        and not is_memo(write)
        and (write.function is not function or id(write.node) in inside)
        and not _is_log(write, adapter, function)
    ]


def _is_log(write: Write, adapter: ModelClass, function: Function) -> bool:
    """Tell whether a write in the loop only collects the batch itself: the attribute was emptied before the loop."""
    return write.function is function and any(
        other.attribute == write.attribute and other.kind == "assigned" for other in writes([function])
    )
