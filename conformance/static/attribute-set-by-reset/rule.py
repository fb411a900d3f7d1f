"""XPL145: A new model can observe before its first reset."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, RESET, RESETTING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, dotted, enclosing, last, self_attribute, targets, texts


@rule(code="XPL145", requirement="XPL-EPI-7")
def attribute_set_by_reset(source: Source) -> Iterator[Finding]:
    """An attribute that update_obs or get_action needs is first set by reset.

    ## What it does
    Compares the attributes that `update_obs` and `get_action` read with those that `__init__` sets, directly or through
    what it calls. It reports an attribute that only `reset` sets, also one of a part of the model. Not reported: class
    attributes, and uses that test first (`hasattr`, `getattr` with a default).

    ## Why it matters
    The first observation after a restart fails with an AttributeError if the client is in mid-episode and does not call
    reset. Tools that try an adapter once get the same error.

    ## Example
    `self.queue = deque()` in `reset` only, and `self.queue.append(...)` in `update_obs`.

    ## Use instead
    Call `self.reset()` at the end of the constructor.

    ## Fix safety
    Safe if `reset` needs nothing that is set later.
    """
    adapter = ModelClass.of(source)
    if not adapter.is_closed:
        return  # a base class that is not here may set it, or call reset
    resetting = [RESET] if adapter.is_sdk else RESETTING
    loading = adapter.reach(*LOADING)
    if any(function.name in resetting for function in loading):
        return
    observing = adapter.reach(*OBSERVING)
    before = [write for function in (*loading, *observing) for write in function.writes]
    made = {write.attribute for write in before if write.kind == "assigned"}
    made |= _of_class(adapter) | _asked(adapter)
    installed = [
        write
        for function in adapter.reach(*resetting)
        for write in function.writes
        if write.kind == "assigned" and write.attribute not in made and not adapter.has(write.attribute)
    ]
    acting = [*observing, *adapter.reach(*ACTING)]
    yield from _defaults(source, adapter.reach(*resetting), loading, acting)
    if not installed:
        return
    needed = _needed(acting)
    missing = {write.attribute: write for write in installed if write.attribute in needed}
    if missing:
        first = next(iter(missing.values()))
        user, node = needed[first.attribute]
        yield Finding(
            f"{' and '.join(f'self.{name}' for name in missing)} exists only after {RESET}: {user.name} of a "
            "new or restarted model raises AttributeError",
            **source.at(user.file, node),
            expected="__init__ sets everything that update_obs and get_action read",
            got=f"first set in {first.function.name}, line {first.line}",
            fix=Fix("advice", "call self.reset() at the end of __init__"),
        )


def _defaults(
    source: Source, resetting: list[Function], loading: list[Function], acting: list[Function]
) -> Iterator[Finding]:
    """Yield a default that reset gives a part of the model where it lacks one, and that acting reads."""
    before = {dotted(target) for function in loading for node in function.of(ast.Assign) for target in targets(node)}
    reads = {node.attr for function in acting for node in function.of(ast.Attribute) if isinstance(node.ctx, ast.Load)}
    not_resetting = {id(function.node) for function in (*loading, *acting) if function.name not in RESETTING}
    for function in resetting:
        if id(function.node) in not_resetting:
            continue
        for branch in function.of(ast.If):
            missing = _lacking(branch.test)
            for node in branch.body:
                for target in targets(node):
                    name = dotted(target)
                    if name in missing and name not in before and last(name) in reads and name.count(".") > 1:
                        yield Finding(
                            f"{name} gets its default only in {RESET}: a new or restarted model acts without it",
                            **source.at(function.file, node),
                            expected="__init__ sets every default",
                            got=ast.unparse(node).split("\n")[0],
                            fix=Fix("advice", "set it in __init__, or call self.reset() at its end"),
                        )


def _lacking(test: ast.expr) -> set[str]:
    """Return what a test finds missing: `getattr(self.config, "causal", None) is None`, `not hasattr(...)`."""
    node: ast.AST = test
    if isinstance(test, ast.Compare) and isinstance(test.ops[0], ast.Is) and constant(test.comparators[0]) is None:
        node = test.left
    elif isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
        node = test.operand
    if isinstance(node, ast.Attribute):
        return {dotted(node)}
    if isinstance(node, ast.Call) and called(node) in {"getattr", "hasattr"} and len(node.args) > 1:
        return {f"{dotted(node.args[0])}.{constant(node.args[1])}"}
    return set()


def _of_class(adapter: ModelClass) -> set[str]:
    return {
        target.id
        for node in adapter.node.body
        if isinstance(node, (ast.Assign, ast.AnnAssign))
        for target in targets(node)
        if isinstance(target, ast.Name)
    }


def _asked(adapter: ModelClass) -> set[str]:
    """Return the attributes whose existence is asked for, or that are set by their name."""
    return {
        text
        for function in adapter.reach(*adapter.methods)
        for node in function.of(ast.Call)
        if called(node) in {"hasattr", "getattr", "setattr"}
        for text in texts(node)
    }


def _needed(functions: list[Function]) -> dict[str, tuple[Function, ast.AST]]:
    """Return the attributes that are read before the same function sets them."""
    reads: dict[str, tuple[Function, ast.AST]] = {}
    for function in functions:
        own = {write.attribute: write.line for write in function.writes if write.kind == "assigned"}
        for node in function.of(ast.Attribute):
            if isinstance(node.ctx, ast.Load) and self_attribute(node) == node.attr:
                guarded = any(isinstance(outer, ast.Try) for outer in enclosing(node, function.up))
                if not guarded and node.lineno < own.get(node.attr, node.lineno + 1):
                    reads.setdefault(node.attr, (function, node))
    return reads
