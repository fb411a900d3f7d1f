"""XPL109: get_action_batch uses the environment indices that the client requests."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACT, ACT_BATCH, ModelClass
from xpl_cli.audit.static.positions import is_list, names_of_list, pairings
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, names, parameters

_FIX = Fix("advice", "keep observations in a dict by environment index, and look up each entry of the list")


@rule(code="XPL109", requirement="XPL-BAT-1")
def batch_by_position(source: Source) -> Iterator[Finding]:
    """get_action_batch ignores the requested environment indices, or only counts them.

    ## What it does
    Follows the list of environment indices through `get_action_batch`. Code that only reads its length, or enumerates
    it without using its entries, knows how many environments are requested, but not which. Code that pairs the list
    with stored observations by position (`self.observations[:len(env_idx_list)]`, `zip(env_idx_list,
    self.observations)`) labels the observation of one environment as that of another.

    ## Why it matters
    Environments of a batch end at different times. When 3 and 7 have ended and only 9 runs, the list is [9]; an adapter
    that indexes by position sends the command of environment 3 to environment 9. Nothing crashes; the success rate
    drops.

    ## Example
    `for i, _ in enumerate(env_idx_list): act(self.observations[i])`.

    ## Use instead
    Derive from `xpl.Policy`, or write `[act(self.observations[env]) for env in env_idx_list]` with a dict.

    ## Fix safety
    No automatic fix.
    """
    function = ModelClass.of(source).method(ACT_BATCH)
    if function is None or not _acts(function):
        return
    parameter_names = parameters(function.node)
    if not parameter_names:
        return
    for message, node in _judged(function, parameter_names[0]):
        yield Finding(
            message,
            **source.at(function.file, node),
            expected=f"each entry of {parameter_names[0]} selects an observation",
            got=ast.unparse(node).split("\n")[0],
            fix=_FIX,
        )


def _acts(function: Function) -> bool:
    """Tell whether the method answers at all, rather than only raising."""
    return any(isinstance(node, ast.Return) and node.value is not None for node in function.nodes)


def _judged(function: Function, parameter: str) -> Iterator[tuple[str, ast.AST]]:
    """Yield what is wrong, and where: no entry of the list is looked at, or entries do not select what is answered."""
    aliases = names_of_list(function, parameter)
    up = function.up
    counted: ast.AST | None = None
    reads = [
        node
        for node in function.nodes
        if isinstance(node, ast.Name) and node.id in aliases and isinstance(node.ctx, ast.Load)
    ]
    for read in reads:
        use = _use(read, up, aliases)
        if use == "content":
            yield from _paired(function, aliases)
            return
        if use == "count":
            counted = counted or _outermost(read, up)
    if counted is not None:
        yield (
            (
                f"{ACT_BATCH}([9]) returns the action of the environment that was observed first, say 3: the list "
                "is only counted, and robots receive each other's commands"
            ),
            counted,
        )
    elif not any(node.id == parameter for node in reads):  # nor looked at in some other way
        yield (
            (
                f"{ACT_BATCH}([9]) returns actions for every observed environment, and so that of 3 for 9: {parameter} "
                "is never read"
            ),
            function.node,
        )


def _paired(function: Function, requested: set[str]) -> Iterator[tuple[str, ast.AST]]:
    """Yield what is wrong with a method that reads the entries of the list, and yet answers by position."""
    paired = next(pairings(function, requested), None)
    if paired is not None:
        yield (
            (
                f"{ACT_BATCH}([9]) acts on the observation that was stored first, say of 3, and labels it 9: "
                "what is stored is taken by position, and robots receive each other's commands"
            ),
            paired,
        )
    repeated = next((node for node in function.of(ast.ListComp) if called(node.elt) == f"self.{ACT}"), None)
    if repeated is not None and not names(repeated.elt) - {"self"}:
        yield f"{ACT_BATCH}([3, 7]) answers both by the one observation that {ACT} knows of", repeated


def _use(read: ast.Name, up: dict[ast.AST, ast.AST], aliases: set[str]) -> str:
    """Say how one mention of the list uses it: its `content`, its `count`, or `nothing`."""
    node: ast.AST = read
    parent = up.get(node)
    while isinstance(parent, (ast.BoolOp, ast.IfExp)) or (isinstance(parent, ast.Call) and is_list(parent, aliases)):
        if isinstance(parent, ast.IfExp) and node is parent.test:
            return "nothing"
        node, parent = parent, up.get(parent)
    is_test = isinstance(parent, (ast.If, ast.While)) and node is parent.test
    if is_test or isinstance(parent, (ast.Assign, ast.AnnAssign, ast.UnaryOp)) or _copies(parent, up, aliases):
        return "nothing"
    if isinstance(parent, ast.Compare):
        return "content" if any(isinstance(entry, (ast.In, ast.NotIn)) for entry in parent.ops) else "nothing"
    return _use_in(parent, up)


def _use_in(parent: ast.AST | None, up: dict[ast.AST, ast.AST]) -> str:
    """Say how a call or a loop uses the list that it gets."""
    name = called(parent) if parent is not None else ""
    if name in {"isinstance", "print", "type"}:
        return "nothing"
    counts = name == "len"
    if isinstance(parent, ast.Call) and name == "enumerate":
        counts = not _entry_is_used(parent, up)
    elif isinstance(parent, (ast.For, ast.comprehension)) and isinstance(parent.target, ast.Name):
        counts = not _is_read(parent.target, parent if isinstance(parent, ast.For) else up[parent])
    return "count" if counts else "content"


def _copies(parent: ast.AST | None, up: dict[ast.AST, ast.AST], aliases: set[str]) -> bool:
    """Tell whether a comprehension only copies the list, into a name that is then followed."""
    whole = up.get(parent) if isinstance(parent, ast.comprehension) else None
    return isinstance(whole, ast.ListComp) and is_list(whole, aliases) and isinstance(up.get(whole), ast.Assign)


def _entry_is_used(call: ast.Call, up: dict[ast.AST, ast.AST]) -> bool:
    parent = up.get(call)
    if not isinstance(parent, (ast.For, ast.comprehension)) or not isinstance(parent.target, ast.Tuple):
        return True
    entry = next(reversed(parent.target.elts), None)
    scope = parent if isinstance(parent, ast.For) else up[parent]
    return not isinstance(entry, ast.Name) or _is_read(entry, scope)


def _is_read(target: ast.Name, scope: ast.AST) -> bool:
    mentions = (node for node in ast.walk(scope) if isinstance(node, ast.Name) and node.id == target.id)
    return any(isinstance(node.ctx, ast.Load) for node in mentions)


def _outermost(node: ast.AST, up: dict[ast.AST, ast.AST]) -> ast.AST:
    """Return the expression or loop header that a mention stands in, for the place of the finding."""
    while isinstance(up.get(node), ast.expr) and names(up[node]):
        node = up[node]
    return node
