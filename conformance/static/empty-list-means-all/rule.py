"""XPL110: get_action_batch returns an empty list for an empty list of environments."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Edit, Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACT_BATCH, ModelClass
from xpl_cli.audit.static.positions import names_of_list
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import always_raises, enclosing, parameters, targets


@rule(code="XPL110", requirement="XPL-BAT-2")
def empty_list_means_all(source: Source) -> Iterator[Finding]:
    """An empty list of environments is treated as "not given".

    ## What it does
    Looks in `get_action_batch` for tests of the list's truth value: `envs or default`, `if not envs: envs = ...`, and
    errors that are raised for an empty list.

    ## Why it matters
    When the last environment has ended, the list is empty. Python treats an empty list as false, so the adapter returns
    actions for every environment, or fails at the end of a successful evaluation.

    ## Example
    `env_idx_list = env_idx_list or self.latest`.

    ## Use instead
    `if env_idx_list is None: env_idx_list = self.latest`.

    ## Fix safety
    Safe: replacing `x or default` by `default if x is None else x`, and `if not x: x = ...` by `if x is None: x = ...`,
    changes the answer to `[]` only. The author has to fix code that raises an error for an empty list.
    """
    function = ModelClass.of(source).method(ACT_BATCH)
    parameter_names = parameters(function.node) if function is not None else []
    if function is None or not parameter_names:
        return
    name = parameter_names[0]
    aliases = names_of_list(function, name)
    for node in function.nodes:
        if isinstance(node, ast.BoolOp) and isinstance(node.op, ast.Or) and _is(node.values[0], name):
            default = " or ".join(ast.unparse(value) for value in node.values[1:])
            yield Finding(
                f"{ACT_BATCH}([]) returns actions for {default} although no environment is running: [] is false",
                **source.at(function.file, node),
                expected="[] is answered by []",
                got=ast.unparse(node),
                fix=_default(source, function, node, f"{default} if {name} is None else {name}"),
            )
        elif isinstance(node, ast.IfExp) and (_is(node.test, name) or _is_not(node.test, name)):
            yield Finding(
                f"{ACT_BATCH}([]) acts as if no list were given although no environment is running",
                **source.at(function.file, node),
                expected="[] is answered by []",
                got=ast.unparse(node),
                fix=Fix("advice", f"test `{name} is None`"),
            )
        elif isinstance(node, ast.If):
            held = next((alias for alias in sorted(aliases) if _is_not(node.test, alias)), None)
            if held is None or _where_none(node, function, name):
                continue
            if any(_knows_none(function.node, alias, node) for alias in aliases):
                continue
            consequence = _consequence(node, held)
            if consequence is not None:
                yield Finding(
                    f"{ACT_BATCH}([]) {consequence} although no environment is running",
                    **source.at(function.file, node.test),
                    expected="[] is answered by []",
                    got=f"if {ast.unparse(node.test)}: {ast.unparse(node.body[0])}",
                    fix=_test(source, function, node, held if held == name else ""),
                )


def _default(source: Source, function: Function, node: ast.BoolOp, text: str) -> Fix:
    """Return the edit of `x or default`."""
    stands_alone = isinstance(function.up.get(node), (ast.Assign, ast.AnnAssign, ast.Return))
    edit = Edit(**source.at(function.file, node), text=text if stands_alone else f"({text})")
    return Fix("safe_edit", text, (edit,))


def _test(source: Source, function: Function, node: ast.If, name: str) -> Fix:
    """Return the edit of `if not x: x = ...`; for every other test or consequence, advice."""
    if name and isinstance(node.test, ast.UnaryOp) and not always_raises(node.body):
        edit = Edit(**source.at(function.file, node.test), text=f"{name} is None")
        return Fix("safe_edit", f"if {name} is None:", (edit,))
    return Fix("advice", "return [] for an empty list before, and test for None where no list may be given")


def _is(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _is_not(node: ast.AST, name: str) -> bool:
    """Tell whether a test is true for an empty list: `not x`, `len(x) == 0`, `not x or ...`."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return _is(node.operand, name)
    if isinstance(node, ast.BoolOp) and isinstance(node.op, ast.Or):
        return any(_is_not(value, name) for value in node.values)
    return isinstance(node, ast.Compare) and ast.unparse(node) == f"len({name}) == 0"


def _consequence(node: ast.If, name: str) -> str | None:
    if always_raises(node.body):
        return "raises"
    if any(_is(target, name) for entry in node.body for target in targets(entry)):
        return "acts as if no list were given"
    return None


def _where_none(node: ast.If, function: Function, name: str) -> bool:
    """Tell whether a test stands where no list was given: in the branch of `if x is None`."""
    inner: ast.AST = node
    for outer in enclosing(node, function.up):
        if isinstance(outer, ast.If) and inner in outer.body and ast.unparse(outer.test) == f"{name} is None":
            return True
        inner = outer
    return False


def _knows_none(function: ast.AST, name: str, before: ast.If) -> bool:
    """Tell whether the same truth test was answered properly before: `if x is not None and not x: return []`."""
    for node in ast.walk(function):
        if isinstance(node, ast.If) and node is not before and node.lineno < before.lineno and node.body:
            returned = node.body[-1]
            if isinstance(returned, ast.Return) and isinstance(returned.value, (ast.List, ast.Name)):
                return f"{name}" in ast.unparse(node.test)
    return False
