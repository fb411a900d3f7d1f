"""XPL141: Asking twice on one observation is answered twice."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import ACTING, LOADING, OBSERVING, RESETTING, Adapter
from xpl_cli.audit.static.aliases import Change, Sharing, stored
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, enclosing, last, names, self_attribute, targets, texts

_SAME_AGAIN = frozenset(("asarray", "array", "ascontiguousarray", "as_tensor", "astype", "float", "str", "int", "list"))
"""Conversions that change nothing the second time."""
_DROPS = frozenset(("clear", "pop", "popitem", "popleft"))


@rule(code="XPL141", requirement="XPL-EPI-5")
def asking_changes(source: Source) -> Iterator[Finding]:
    """Asking for an action changes or drops the stored observation.

    ## What it does
    Collects the attributes that the observing methods fill, follows them through the acting methods, and looks for
    entries that are replaced by something made of themselves, for entries that are taken out, and for attributes that
    are emptied. Queues that the acting methods fill themselves do not count.

    ## Why it matters
    A client that asks again, after a time-out or for a second opinion, gets an exception, or an action from an image
    that was normalised twice.

    ## Example
    `obs = self.latest; obs["image"] = self.transform(obs["image"])` in `get_action`.

    ## Use instead
    A new map for the model's inputs: `{**obs, "image": self.transform(obs["image"])}`.

    ## Fix safety
    No automatic fix.
    """
    adapter = Adapter.of(source)
    observing = adapter.reach(*OBSERVING)
    elsewhere = {id(function.node) for function in [*observing, *adapter.reach(*RESETTING, *LOADING)]}
    acting = [function for function in adapter.reach(*ACTING) if id(function.node) not in elsewhere]
    filled_here = {write.attribute for one in acting for write in one.writes if not _is_emptied(write.node)}
    held = stored(observing)
    held = {name: held[name] for name in held if name not in filled_here or _is_map(acting, name)}
    sharing = Sharing(adapter, held)
    for function in (adapter.method(name) for name in ACTING):
        if function is not None and held:
            sharing.follow(function, {})
    inside = {id(function.node) for function in acting}
    found: dict[int, tuple[Function, ast.AST, str]] = {}
    for change in sharing.changes:
        if id(change.function.node) in inside and _matters(change):
            what = "changed" if change.how in {"set", "augmented"} else "taken out"
            found[id(change.node)] = (change.function, change.node, f"{change.key or 'an entry'} is {what}")
    for function, node, attribute in _dropped(acting, set(held) - filled_here):
        found[id(node)] = (function, node, f"self.{attribute} is dropped")
    for function, node, what in found.values():
        yield Finding(
            f"{what} while an action is computed: asked again on the same observation, the model fails or sees another",
            **source.at(function.file, node),
            expected="stored observations that only observing and reset change",
            got=ast.unparse(node).split("\n")[0],
            fix=Fix("advice", "build the model's inputs in a new map, and leave the stored observation alone"),
        )


def _matters(change: Change) -> bool:
    """Tell whether the second time differs from the first."""
    if change.how == "augmented":
        matters = isinstance(change.node, ast.AugAssign) and isinstance(change.node.target, ast.Subscript)
    elif change.key is None:
        matters = change.how == "set" and _is_replaced(change)
    elif change.how == "set":
        value, before = change.value, change.before
        is_same = before is not None and before.keys == (*change.held.keys, change.key)
        matters = value is not None and not is_same and _is_made_anew(value, change.key)
    else:
        matters = change.how == "deleted" or last(called(change.node)) == "pop"
    return matters and not _is_guarded(change)


def _is_made_anew(value: ast.expr, key: str) -> bool:
    """Tell whether a value is made of the entry that it replaces, and differs when that is done twice."""
    return key in texts(value) | names(value) and last(called(value)) not in _SAME_AGAIN


def _is_replaced(change: Change) -> bool:
    """Tell whether an entry whose key a name holds is replaced by what is made of it, through other names too."""
    target = next((entry for entry in targets(change.node) if isinstance(entry, ast.Subscript)), None)
    if target is None or not isinstance(target.slice, ast.Name) or change.value is None:
        return False
    before = ast.unparse(target)
    made: set[str] = set()
    for node in change.function.of(ast.Assign):
        if node is not change.node and (before in ast.unparse(node.value) or names(node.value) & made):
            made |= {entry.id for entry in targets(node) if isinstance(entry, ast.Name)}
    is_made = before in ast.unparse(change.value) or bool(names(change.value) & made)
    values: list[ast.expr] = [change.value]
    if isinstance(change.value, ast.Name):
        values = [node.value for node in change.function.of(ast.Assign) if names(change.value) & set(_bound(node))]
    is_other = any(isinstance(one, (ast.BinOp, ast.Call)) and last(called(one)) not in _SAME_AGAIN for one in values)
    return is_made and is_other


def _bound(node: ast.Assign) -> list[str]:
    return [entry.id for entry in targets(node) if isinstance(entry, ast.Name)]


def _is_guarded(change: Change) -> bool:
    """Tell whether a change is made only where it was not made yet."""
    tests = (outer.test for outer in enclosing(change.node, change.function.up) if isinstance(outer, ast.If))
    return any(isinstance(node, (ast.NotIn, ast.In, ast.Is)) or last(called(node)) == "isinstance"
               for test in tests for node in ast.walk(test))  # fmt: skip


def _is_emptied(node: ast.AST) -> bool:
    value = getattr(node, "value", None)
    if not isinstance(node, (ast.Assign, ast.AnnAssign)):
        return False
    empty = isinstance(value, (ast.List, ast.Dict, ast.Tuple)) and not list(ast.iter_child_nodes(value))[:-1]
    return empty or (isinstance(value, ast.Constant) and value.value is None)


def _is_map(functions: list[Function], attribute: str) -> bool:
    """Tell whether these functions only set entries of an attribute, below its own level."""
    return all(write.kind == "keyed" for one in functions for write in one.writes if write.attribute == attribute)


def _dropped(functions: list[Function], attributes: set[str]) -> Iterator[tuple[Function, ast.AST, str]]:
    """Yield where these functions empty an attribute, or take an environment's observation out of it."""
    for function in functions:
        for node in function.of(ast.Assign, ast.AnnAssign, ast.Delete, ast.Call):
            found: list[str | None] = []
            if isinstance(node, (ast.Assign, ast.AnnAssign)) and _is_emptied(node):
                found = [self_attribute(target) for target in targets(node) if isinstance(target, ast.Attribute)]
            elif isinstance(node, ast.Delete):
                found = [self_attribute(target) for target in node.targets]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _DROPS:
                found = [self_attribute(node.func.value)] if isinstance(node.func.value, ast.Attribute) else []
            for attribute in found:
                if attribute in attributes and not _bounds(node, function):
                    yield function, node, attribute


def _bounds(node: ast.AST, function: Function) -> bool:
    """Tell whether something is dropped only to keep a length, or because it is no longer valid."""
    tests = (outer.test for outer in enclosing(node, function.up) if isinstance(outer, (ast.If, ast.While)))
    return any(isinstance(child, ast.Compare) for test in tests for child in ast.walk(test))
