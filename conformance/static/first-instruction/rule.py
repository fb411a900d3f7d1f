"""XPL114: Each environment of a batch is conditioned on its own instruction."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import ACT_BATCH, UPDATE_BATCH, Adapter
from xpl_cli.audit.static.episode import mentioned
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import (
    called,
    constant,
    dotted,
    enclosing,
    key_read,
    parameters,
    self_attribute,
    targets,
)

_KEYS = frozenset((sdk.Obs.INSTRUCTION, sdk.Obs.INSTRUCTIONS, "prompt", "lang", "language", "text"))
_FIX = Fix("advice", "keep the instruction with the observation it came with, and pass a list of them to the model")


@rule(code="XPL114", requirement="XPL-BAT-6")
def first_instruction(source: Source) -> Iterator[Finding]:
    """One environment's instruction is used for the whole batch.

    ## What it does
    Looks in the batch operations and in `predict` for instructions that are taken from entry 0 of the batch, also of an
    attribute that holds it, or
    stored in one attribute by a loop over the batch, so that the last one wins.

    ## Why it matters
    Environments of a batch may play different tasks, and the same task has many wordings. All but one of them then act
    on an instruction that was not theirs.

    ## Example
    `prompt = obs_list[0]["instruction"]` in `update_obs_batch`.

    ## Use instead
    `prompts = [obs["instruction"] for obs in obs_list]`.

    ## Fix safety
    No automatic fix.
    """
    adapter = Adapter.of(source)
    reading = mentioned(adapter.reach(ACT_BATCH))
    kept = _kept(adapter.method(UPDATE_BATCH))
    for name in (UPDATE_BATCH, ACT_BATCH, "predict"):
        function = adapter.method(name)
        if function is None or not parameters(function.node) or _refuses_batches(function):
            continue
        for node, consequence in (*_first(function, kept), *_last(function, reading)):
            yield Finding(
                f"the whole batch acts on the instruction of {consequence}",
                **source.at(function.file, node),
                expected="one instruction per environment",
                got=ast.unparse(node).split("\n")[0],
                fix=_FIX,
            )


def _kept(function: Function | None) -> set[str]:
    """Return the attributes that hold a whole batch, as it came or one entry for each observation: `self.batch`."""
    if function is None or not parameters(function.node):
        return set()
    batch = parameters(function.node)[0]
    found: set[str] = set()
    for node in function.of(ast.Assign):
        value = node.value
        if isinstance(value, ast.Call) and called(value) in {"list", "tuple"} and value.args:
            value = value.args[0]
        if isinstance(value, (ast.ListComp, ast.GeneratorExp)):
            value = value.generators[0].iter
        if isinstance(value, ast.Call) and called(value) == "enumerate" and value.args:
            value = value.args[0]
        if isinstance(value, ast.Name) and value.id == batch:
            found |= {f"self.{target.attr}" for target in targets(node) if isinstance(target, ast.Attribute)}
    return found


def _first(function: Function, kept: set[str]) -> Iterator[tuple[ast.AST, str]]:
    """Yield reads of the instruction from entry 0 of a batch, under its own name or that of an attribute."""
    batch = {parameters(function.node)[0], *kept}
    firsts = {
        target.id
        for node in function.nodes
        if isinstance(node, ast.Assign) and _is_first(node.value, batch)
        for target in targets(node)
        if isinstance(target, ast.Name)
    }
    for node in function.nodes:
        found = key_read(node)
        if found is not None and found.key in _KEYS:
            owner = found.owner
            if _is_first(owner, batch) or (isinstance(owner, ast.Name) and owner.id in firsts):
                yield node, "its first environment"
                return


def _last(function: Function, reading: set[str]) -> Iterator[tuple[ast.AST, str]]:
    """Yield loops over the batch that store an instruction in one attribute, which actions are then computed from."""
    if function.name != UPDATE_BATCH:
        return
    for node in function.nodes:
        if isinstance(node, ast.Assign) and any(isinstance(entry, ast.For) for entry in enclosing(node, function.up)):
            reads = (key_read(child) for child in ast.walk(node.value))
            if any(found is not None and found.key in _KEYS for found in reads):
                for target in targets(node):
                    if isinstance(target, ast.Attribute) and self_attribute(target) in reading:
                        yield node, "its last environment"


def _is_first(node: ast.AST, batch: set[str]) -> bool:
    return isinstance(node, ast.Subscript) and constant(node.slice) == 0 and dotted(node.value) in batch


def _refuses_batches(function: Function) -> bool:
    """Tell whether the method refuses batches of more than one."""
    return any(
        isinstance(node, ast.If)
        and "len(" in ast.unparse(node.test)
        and any(isinstance(entry, ast.Raise) for entry in node.body)
        and "1" in ast.unparse(node.test)
        for node in function.nodes
    )
