"""XPL172: The number of environments comes from the request."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import symbols
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import FunctionNode, called, constant, dotted, last, names, self_attribute, targets
from xpl_cli.standard import spec

_ENVIRONMENT: Final = re.compile(rf"{sdk.Obs.ENV_IDX}|env(ironment)?(_?id|_index)?|idx_env")
_COUNT: Final = re.compile(r"(num|n)_?envs?|num_environments|batch_of_envs")


@rule(code="XPL172", requirement="XPL-BAT-8")
def fixed_environments(source: Source) -> Iterator[Finding]:
    """There is room for a fixed number of environments, or only the first few are asked.

    ## What it does
    Finds lists of a constant length that are later indexed by an environment (`[deque() for _ in range(100)]`), in the
    classes that model.py and deploy.py reach, and evaluation loops that go through environments by a constant count or
    a literal list.

    ## Why it matters
    Environment 100 of a larger run raises an IndexError in the middle of an evaluation. A loop over `range(4)` asks
    environments that have ended, and never those beyond.

    ## Example
    `self.buffers = [deque(maxlen=2) for _ in range(100)]`, then `self.buffers[env_idx].append(obs)`.

    ## Use instead
    A map by environment: `defaultdict(lambda: deque(maxlen=2))`; in the loop, `TASK_ENV.get_running_env_idx_list()`.

    ## Fix safety
    No automatic fix: a list and a map are cleared and counted in other ways.
    """
    for file in dict.fromkeys((*source.reached(sdk.File.MODEL_PY), *source.reached(sdk.File.DEPLOY_PY))):
        if source.parses(file):
            for owner, node in symbols(source, file).classes.values():
                if owner == file:
                    yield from _stores(source, file, node)
    if source.has(sdk.File.DEPLOY_PY) and source.parses(sdk.File.DEPLOY_PY):
        yield from _loops(source)


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
    for node in nodes:
        if isinstance(node, (ast.Assign, ast.AnnAssign)):
            size = _size(node.value) if node.value is not None else None
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
            f"{name} has room for {size} environments: environment {size} ends the evaluation with an IndexError",
            **source.at(file, node),
            expected="a map by environment, which grows with the run",
            got=ast.unparse(node),
            fix=Fix("advice", f"make {name} a dict, or a defaultdict, by {sdk.Obs.ENV_IDX}"),
        )


def _size(value: ast.expr) -> int | None:
    """Return the constant length of a list: a comprehension over range(N), or [...] * N."""
    size: object = None
    if isinstance(value, ast.ListComp) and len(value.generators) == 1:
        source = value.generators[0].iter
        if called(source) == "range" and isinstance(source, ast.Call) and len(source.args) == 1:
            size = constant(source.args[0])
    elif isinstance(value, ast.BinOp) and isinstance(value.op, ast.Mult) and isinstance(value.left, ast.List):
        size = constant(value.right)
    return size if isinstance(size, int) and size > 1 else None


def _loops(source: Source) -> Iterator[Finding]:
    """Yield lists of environments in the evaluation loop that are constants."""
    known = symbols(source, sdk.File.DEPLOY_PY).functions
    for name in spec.data("package")["loop"]["functions"]:
        function = known.get(name)
        for node in function.of(ast.Call, ast.For, ast.comprehension) if function else ():
            given = _fixed(function, node) if function else None
            if given is not None:
                yield Finding(
                    f"{name} goes through {ast.unparse(given)}, whichever environments run: "
                    "those that have ended are asked, and others never",
                    **source.at(sdk.File.DEPLOY_PY, given),
                    expected="TASK_ENV.get_running_env_idx_list()",
                    got=ast.unparse(given),
                    fix=Fix("advice", "take the environments from TASK_ENV.get_running_env_idx_list()"),
                )
                return


def _fixed(function: Function, node: ast.AST) -> ast.expr | None:
    """Return the constant list that stands for the environments: `range(4)`, `[0, 1]`, a count with a literal value."""
    if isinstance(node, (ast.For, ast.comprehension)):
        is_environment = any(_ENVIRONMENT.fullmatch(name) for name in names(node.target))
        return node.iter if is_environment and _is_constant(function, node.iter) else None
    if isinstance(node, ast.Call) and last(called(node)) in {"get_obs_batch", "take_action_batch"}:
        return next((value for value in node.args[-1:] if _is_constant(function, value)), None)
    return None


def _is_constant(function: Function, value: ast.expr) -> bool:
    if isinstance(value, (ast.List, ast.Tuple)):
        return len(value.elts) > 1 and all(isinstance(constant(entry), int) for entry in value.elts)
    if isinstance(value, ast.Call) and called(value) == "list" and value.args:
        return _is_constant(function, value.args[0])
    if isinstance(value, ast.Call) and called(value) == "range" and len(value.args) == 1:
        size = value.args[0]
        if isinstance(size, ast.Name) and _COUNT.fullmatch(size.id):
            given = [node.value for node in function.of(ast.Assign) if any(dotted(t) == size.id for t in targets(node))]
            return len(given) == 1 and isinstance(constant(given[0]), int)
        return isinstance(constant(size), int)
    return False
