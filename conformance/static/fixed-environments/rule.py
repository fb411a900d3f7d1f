"""XPL172: The number of environments comes from the request."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.model_class import symbols
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import FunctionNode, assigned, called, constant, dotted, last, self_attribute, targets

_ENVIRONMENT: Final = re.compile(rf"{sdk.Obs.ENV_IDX}|env(ironment)?(_?id|_index)?|idx_env")


@rule(code="XPL172", requirement="XPL-BAT-8")
def fixed_environments(source: Source) -> Iterator[Finding]:
    """The adapter has space for a fixed number of environments.

    ## What it does
    Finds lists of a constant length that are later indexed by an environment (`[deque() for _ in range(100)]`), in the
    classes that model.py and deploy.py use.

    ## Why it matters
    Environment 100 of a larger run raises an IndexError in the middle of an evaluation.

    ## Example
    `self.buffers = [deque(maxlen=2) for _ in range(100)]`, then `self.buffers[env_idx].append(obs)`.

    ## Use instead
    A dict by environment: `defaultdict(lambda: deque(maxlen=2))`.

    ## Fix safety
    No automatic fix: a list and a dict are cleared and counted differently.
    """
    for file in dict.fromkeys((*source.reached(sdk.File.MODEL_PY), *source.reached(sdk.File.DEPLOY_PY))):
        if source.parses(file):
            for owner, node in symbols(source, file).classes.values():
                if owner == file:
                    yield from _stores(source, file, node)


def _stores(source: Source, file: str, owner: ast.ClassDef) -> Iterator[Finding]:
    """Yield attributes of a class that hold a constant number of things, one for each environment."""
    made: dict[str, tuple[ast.expr, int]] = {}
    indexed: set[str] = set()
    nodes = [
        node
        for child in owner.body
        if isinstance(child, FunctionNode)
        for node in source.function(file, child, owner).of(ast.Assign, ast.AnnAssign, ast.Subscript)
    ]
    constants = assigned(source.tree(file).body)
    for node in nodes:
        if isinstance(node, (ast.Assign, ast.AnnAssign)):
            size = _size(node.value, constants) if node.value is not None else None
            for target in targets(node) if size else []:
                name = self_attribute(target) if isinstance(target, ast.Attribute) else None
                if name and size and node.value is not None:
                    made[name] = (node.value, size)
        elif isinstance(node, ast.Subscript) and isinstance(node.value, ast.Attribute):
            name = self_attribute(node.value)
            if name and _ENVIRONMENT.fullmatch(last(dotted(node.slice))):
                indexed.add(name)
    for name in sorted(made.keys() & indexed):
        node, size = made[name]
        yield Finding(
            f"{name} has space for {size} environments: environment {size} ends the evaluation with an IndexError",
            **source.at(file, node),
            expected="a dict by environment, which grows with the run",
            got=ast.unparse(node),
            fix=Fix("advice", f"make {name} a dict, or a defaultdict, by {sdk.Obs.ENV_IDX}"),
        )


def _size(value: ast.expr, constants: dict[str, ast.expr]) -> int | None:
    """Return the constant length of a list: a comprehension over range(N), or [...] * N; N may be the module's."""
    size: object = None
    if isinstance(value, ast.ListComp) and len(value.generators) == 1:
        source = value.generators[0].iter
        if called(source) == "range" and isinstance(source, ast.Call) and len(source.args) == 1:
            size = constant(_resolved(source.args[0], constants))
    elif isinstance(value, ast.BinOp) and isinstance(value.op, ast.Mult) and isinstance(value.left, ast.List):
        size = constant(_resolved(value.right, constants))
    return size if isinstance(size, int) and size > 1 else None


def _resolved(node: ast.expr, constants: dict[str, ast.expr]) -> ast.expr:
    return constants.get(node.id, node) if isinstance(node, ast.Name) else node
