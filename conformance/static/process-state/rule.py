"""XPL143: What an episode leaves behind belongs to the model, where reset reaches it."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import ACTING, LOADING, OBSERVING, RESETTING, Adapter
from xpl_cli.audit.static.episode import mentioned
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, dotted, enclosing, last, parameters, targets

_MUTABLE = frozenset(("list", "dict", "set", "deque", "defaultdict", "OrderedDict", "Counter"))
_CHANGES = frozenset(("append", "appendleft", "extend", "add", "update", "insert", "setdefault", "pop", "clear"))


@rule(code="XPL143", requirement="XPL-EPI-1")
def process_state(source: Source) -> Iterator[Finding]:
    """State of an episode is kept in a module, in the class, or in a default argument.

    ## What it does
    Looks in what the observing and acting methods reach for changes of names of the module (also through `global`), of
    lists and maps that the class body makes, and of mutable default arguments. Caches that are filled only where an
    entry is missing do not count, nor does what reset names.

    ## Why it matters
    Such state outlives the episode and the model: every `Model` of the process shares it, and `reset` leaves it. The
    next episode continues the history of the last one, or of another robot.

    ## Example
    `class Model:` with `history = []` in its body, and `self.history.append(obs)`.

    ## Use instead
    `self.history = []` in `reset`, which the constructor calls.

    ## Fix safety
    No automatic fix.
    """
    adapter = Adapter.of(source)
    resetting = adapter.reach(*RESETTING)
    forgotten = {node.id for function in resetting for node in function.of(ast.Name)}
    renewing = [*adapter.reach(*LOADING), *resetting]
    renewed = {write.attribute for one in renewing for write in one.writes if write.kind == "assigned"}
    shared = _shared(adapter) - renewed
    cleared = mentioned(resetting)
    for function in adapter.reach(*OBSERVING, *ACTING):
        defaults = _defaults(function)
        for node, name in _changed(function):
            if name.startswith("self."):
                attribute = name.removeprefix("self.")
                if attribute not in shared or _is_memo(node, function):
                    continue
                where = f"{name} belongs to the class: every Model of the process shares it" + (
                    "" if attribute in cleared else ", and reset leaves it"
                )
            elif name in defaults:
                where = f"the default of {name} is made once: what one call leaves in it, the next one finds"
            elif name not in forgotten and name in _module(source, function) and not _is_memo(node, function):
                where = f"{name} belongs to the module: it outlives reset, and every Model of the process shares it"
            else:
                continue
            yield Finding(
                f"{where}; the next episode goes on with what this one left",
                **source.at(function.file, node),
                expected="an attribute that the constructor and reset set anew",
                got=ast.unparse(node).split("\n")[0],
                fix=Fix("advice", "keep it in an attribute that __init__ and reset both set"),
            )
            break


def _changed(function: Function) -> Iterator[tuple[ast.AST, str]]:
    """Yield what a function changes without binding a name of its own: `x` by its name, attributes as `self.x`."""
    declared = {name for node in function.of(ast.Global) for name in node.names}
    own = {
        target.id
        for node in function.of(ast.Assign, ast.AnnAssign, ast.For, ast.withitem, ast.NamedExpr)
        for target in targets(node)
        if isinstance(target, ast.Name)
    } - declared
    for node in function.of(ast.Assign, ast.AugAssign, ast.Call):
        changed: list[ast.expr] = []
        if isinstance(node, (ast.Assign, ast.AugAssign)):
            changed = [target.value for target in targets(node) if isinstance(target, ast.Subscript)]
            yield from (
                (node, target.id) for target in targets(node) if isinstance(target, ast.Name) and target.id in declared
            )
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _CHANGES:
            changed = [node.func.value]
        for value in changed:
            name = _owner(value)
            if name and name not in own:
                yield node, name


def _owner(value: ast.expr) -> str:
    """Return what holds an entry: the name of a variable, `self.x` for an attribute of the model or of its class."""
    while isinstance(value, ast.Subscript):
        value = value.value
    name = dotted(value)
    return f"self.{last(name)}" if name.startswith(("self.", "cls.", f"{sdk.MODEL_CLASS}.")) else name


def _module(source: Source, function: Function) -> set[str]:
    """Return the names that a function's module binds."""
    return {
        target.id
        for node in source.tree(function.file).body
        if isinstance(node, (ast.Assign, ast.AnnAssign))
        for target in targets(node)
        if isinstance(target, ast.Name)
    } - set(parameters(function.node))


def _shared(adapter: Adapter) -> set[str]:
    """Return the lists and maps that the class body makes."""
    return {
        target.id
        for node in adapter.node.body
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None and _is_mutable(node.value)
        for target in targets(node)
        if isinstance(target, ast.Name)
    }


def _defaults(function: Function) -> set[str]:
    given = function.node.args
    names_of = [argument.arg for argument in (*given.posonlyargs, *given.args)]
    plain = zip(reversed(names_of), reversed(given.defaults), strict=False)
    named = zip((argument.arg for argument in given.kwonlyargs), given.kw_defaults, strict=True)
    return {name for name, value in (*plain, *named) if value is not None and _is_mutable(value)}


def _is_mutable(value: ast.expr) -> bool:
    return isinstance(value, (ast.List, ast.Dict, ast.Set)) or last(called(value)) in _MUTABLE


def _is_memo(node: ast.AST, function: Function) -> bool:
    """Tell whether a change is made only where something is missing: a cache, a warning that is given once."""
    for outer in enclosing(node, function.up):
        if isinstance(outer, ast.If) and any(
            isinstance(child, (ast.NotIn, ast.Is, ast.Not)) for child in ast.walk(outer.test)
        ):
            return True
        if isinstance(outer, ast.ExceptHandler):
            return True
    return isinstance(node, ast.Call) and last(called(node)) == "setdefault"
