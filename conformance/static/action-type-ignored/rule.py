"""XPL149: The adapter honours action_type, or refuses one it cannot serve."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.episode_state import is_reported, only_reports
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import dotted, last, targets, texts
from xpl_cli.audit.static.unread import is_unread

_KEY = sdk.Deploy.ACTION_TYPE
_SUFFIXES = {sdk.State.ARM_JOINT_STATE: "joint", sdk.State.EE_POSE: "ee"}


@rule(code="XPL149", requirement="XPL-ACT-10")
def action_type_ignored(source: Source) -> Iterator[Finding]:
    """The adapter returns one type of action, whatever action_type the configuration requests.

    ## What it does
    Looks at how `action_type` is used: a comparison that only logs a warning, by `print` or a logger, and adapters that
    write the keys of one action type and never read `action_type`, even if they store it, or read only other keys of
    the configuration. Not reported: adapters that pass the whole configuration on or raise an error, and adapters of
    the SDK whose manifest declares one type, since the base class refuses the other.

    ## Why it matters
    A run labelled `ee` was a run with joint commands, or an environment that expects a pose gets none. The client does
    not see a warning in a server's log.

    ## Example
    `if self.action_type != "joint": print("only joint is supported")`.

    ## Use instead
    `raise ValueError(...)` in the constructor, or both forms; `xpl.action.unpack` writes either.

    ## Fix safety
    Raising where a warning was printed is safe for runs whose type was served.
    """
    adapter = ModelClass.of(source)
    if adapter.is_sdk and "decode" not in adapter.methods:
        return  # the base class decodes either type
    functions = adapter.reach(*adapter.methods)
    for function in functions:
        for node in function.of(ast.If):
            if not node.orelse and all(map(only_reports, node.body)) and _compares(node.test, _named(function)):
                yield Finding(
                    f"an {_KEY} that the adapter cannot serve is only warned about: the run is labelled with "
                    "one action type and executed with the other",
                    **source.at(function.file, node.test),
                    expected="an error",
                    got=ast.unparse(node.body[0]).split("\n")[0],
                    fix=Fix("advice", f"raise an error if {_KEY} is one that the policy cannot serve"),
                )
    if adapter.is_sdk and len(source.manifest.action_types) == 1:
        return  # the base class refuses the other type
    idle = _idle(functions)
    if not adapter.config_escapes and not any(_mentions(function, idle) for function in functions):
        written = _written(adapter)
        if written is None and not adapter.is_sdk and is_unread(adapter, _KEY):
            yield Finding(
                f"no code reads {_KEY}: a run with the other type gets the same actions, under its label",
                **source.start(adapter.file, adapter.node),
                expected=f"a decision by {_KEY}, or an error for a type that cannot be served",
                got="a configuration of which other keys are read",
                fix=Fix("advice", f"raise an error unless {_KEY} is the one that the policy serves"),
            )
        elif written is not None:
            function, key, kind = written
            yield Finding(
                f"{_KEY} is never used, and actions are always of type {kind}: a run with the other type gets "
                "these, under its label",
                **source.at(function.file, key),
                expected=f"a decision by {_KEY}, or an error for a type that cannot be served",
                got=ast.unparse(key).split("\n")[0],
                fix=Fix("advice", f"raise an error unless {_KEY} is {kind!r}"),
            )


def _named(function: Function) -> set[str]:
    """Return the local names that hold the type of action."""
    return {
        target.id
        for node in function.of(ast.Assign)
        if any(_KEY in (last(dotted(part)), *texts(part)) for part in ast.walk(node.value))
        for target in targets(node)
        if isinstance(target, ast.Name)
    }


def _compares(test: ast.expr, named: set[str]) -> bool:
    return any(
        isinstance(node, ast.Compare)
        and any(
            _KEY in (last(dotted(part)), *texts(part)) or getattr(part, "id", "") in named for part in ast.walk(node)
        )
        for node in ast.walk(test)
    )


def _mentions(function: Function, idle: set[int]) -> bool:
    return any(
        _KEY in (getattr(node, name, None) for name in ("id", "attr", "value", "arg")) and id(node) not in idle
        for node in function.of(ast.Constant, ast.Name, ast.Attribute, ast.arg, ast.keyword)
    )


def _idle(functions: list[Function]) -> set[int]:
    """Return the nodes of statements that put the value into an attribute which nothing reads but messages."""
    read = {
        node.attr
        for function in functions
        for node in function.of(ast.Attribute)
        if isinstance(node.ctx, ast.Load) and not is_reported(node, function)
    }
    node_ids: set[int] = set()
    for function in functions:
        for node in function.of(ast.Assign, ast.AnnAssign):
            stored = [target.attr for target in targets(node) if isinstance(target, ast.Attribute)]
            if stored and not read.intersection(stored) and _KEY in texts(node) | set(stored):
                node_ids |= {id(child) for child in ast.walk(node)}
        node_ids |= {
            id(mention)
            for mention in function.of(ast.Attribute)
            if mention.attr == _KEY and is_reported(mention, function)
        }
    return node_ids


def _written(adapter: ModelClass) -> tuple[Function, ast.AST, str] | None:
    """Return where the acting methods write action keys of one type only."""
    first_by_type: dict[str, tuple[Function, ast.AST]] = {}
    for function in adapter.reach(*ACTING):
        for node in function.of(ast.Dict, ast.Subscript):
            keys: list[ast.expr | None] = []
            if isinstance(node, ast.Dict):
                keys = list(node.keys)
            elif isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
                keys = [node.slice]
            for key in keys:
                for suffix, kind in _SUFFIXES.items():
                    if key is not None and any(text.endswith(suffix) for text in texts(key)):
                        first_by_type.setdefault(kind, (function, key))
    if len(first_by_type) != 1:
        return None
    kind, (function, first) = next(iter(first_by_type.items()))
    return function, first, kind
