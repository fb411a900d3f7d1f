"""XPL142: The memory of an episode is bounded."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.episode_state import is_memo
from xpl_cli.audit.static.function import Function, Write
from xpl_cli.audit.static.model_class import ACTING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, enclosing, last, self_attribute, targets

_ADDS = frozenset(("append", "appendleft", "extend", "insert"))
_ENTRIES = frozenset(("setdefault", "get"))
_REMOVES = frozenset(("pop", "popleft", "clear", "remove", "get", "get_nowait"))


@rule(code="XPL142", requirement="XPL-EPI-6")
def unbounded_history(source: Source) -> Iterator[Finding]:
    """A list grows with every observation or action until reset.

    ## What it does
    Looks for lists that `update_obs` and `get_action` append to, in the class itself and in its attributes that are
    objects of the adapter's own classes, and for anything that bounds them: `maxlen`, a slice that is assigned back,
    `pop`, `del`, a test of the length, or a new list.

    ## Why it matters
    Three cameras at 25 Hz are 70 MB per second: a long episode runs out of memory. If the whole list goes into the
    model, each step takes longer than the previous one.

    ## Example
    `self.frames.append(image)` in `update_obs`, with `self.frames[-4:]` read in `get_action`.

    ## Use instead
    `collections.deque(maxlen=4)`, or `temporal.history` in policy.yml and `xpl.Policy`.

    ## Fix safety
    Safe if only the newest entries are read.
    """
    adapter = ModelClass.of(source)
    for holder, one in (("self", adapter), *((f"self.{name}", other) for name, other in adapter.components.items())):
        functions = one.reach(*OBSERVING, *ACTING) if one is adapter else one.reach(*_used(adapter, holder))
        grown = [write for function in functions for write in function.writes if _adds(write.node)]
        grown += [write for function in functions for write in _by_alias(function)]
        bounded = _bounded(functions, one) if grown else set()
        reported: set[str] = set()
        for write in grown:
            if write.attribute in bounded | reported or is_memo(write):
                continue
            if _is_bounded_here(write.node, write.function, write.attribute):
                continue
            reported.add(write.attribute)
            yield Finding(
                f"{holder}.{write.attribute} grows by one entry at every call of {write.function.name} until reset: "
                "a long episode runs out of memory",
                **source.at(write.function.file, write.node),
                expected="a bound, such as deque(maxlen=...)",
                got=ast.unparse(write.node).split("\n")[0],
                fix=Fix("advice", "use collections.deque(maxlen=N), where N is the number that the model reads"),
            )


def _used(adapter: ModelClass, holder: str) -> list[str]:
    """Return the methods of an object that the observing and acting methods call."""
    return [
        node.func.attr
        for function in adapter.reach(*OBSERVING, *ACTING)
        for node in function.of(ast.Call)
        if isinstance(node.func, ast.Attribute) and called(node).startswith(f"{holder}.")
    ]


def _aliases(function: Function) -> dict[str, str]:
    """Return the local names of entries: `frames` of `frames = self.frames.setdefault(env, [])`, with the attribute."""
    aliases: dict[str, str] = {}
    for node in function.of(ast.Assign):
        value = node.value
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Attribute) and value.func.attr in _ENTRIES:
            value = value.func.value
        elif isinstance(value, ast.Subscript) and not isinstance(value.slice, ast.Slice):
            value = value.value
        else:
            continue
        attribute = self_attribute(value)
        if attribute is not None and "maxlen" not in ast.unparse(node):
            aliases |= {target.id: attribute for target in targets(node) if isinstance(target, ast.Name)}
    return aliases


def _by_alias(function: Function) -> Iterator[Write]:
    """Yield what is added to an entry by a local name of it."""
    aliases = _aliases(function)
    for more in function.of(ast.AugAssign) if aliases else ():
        if isinstance(more.target, ast.Name) and more.target.id in aliases and _adds(more):
            yield Write(aliases[more.target.id], "keyed", function, more)
    for node in function.of(ast.Call) if aliases else ():
        if isinstance(node.func, ast.Attribute) and node.func.attr in _ADDS and isinstance(node.func.value, ast.Name):
            attribute = aliases.get(node.func.value.id)
            if attribute is not None:
                yield Write(attribute, "keyed", function, node)


def _shortened(node: ast.AST, aliases: dict[str, str]) -> set[str | None]:
    """Return the attribute whose entry a node shortens by a local name of it."""
    names: list[ast.AST] = []
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _REMOVES:
        names = [node.func.value]
    elif isinstance(node, ast.Delete):
        names = [target.value for target in node.targets if isinstance(target, ast.Subscript)]
    elif isinstance(node, ast.Assign):
        names = [target.value for target in targets(node) if isinstance(target, ast.Subscript)]
    return {aliases.get(name.id) for name in names if isinstance(name, ast.Name)}


def _adds(node: ast.AST) -> bool:
    if isinstance(node, ast.AugAssign):
        return isinstance(node.op, ast.Add) and isinstance(node.value, (ast.List, ast.ListComp))
    return isinstance(node, ast.Call) and last(called(node)) in _ADDS


def _bounded(functions: list[Function], adapter: ModelClass) -> set[str]:
    """Return the attributes that something shortens, renews or bounds."""
    bounded: set[str | None] = set()
    for function in functions:
        aliases = _aliases(function)
        for node in function.of(ast.Assign, ast.AnnAssign, ast.Delete, ast.Call):
            bounded |= _shortened(node, aliases)
            if isinstance(node, (ast.Assign, ast.AnnAssign)):
                bounded.update(
                    one for target in targets(node) if not _is_first(one := self_attribute(target), node, function)
                )
            elif isinstance(node, ast.Delete):
                bounded.update(self_attribute(target) for target in node.targets)
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _REMOVES:
                is_look_up = node.func.attr == "get" and bool(node.args)
                bounded.add(None if is_look_up else self_attribute(node.func.value))
    for function in adapter.reach(*adapter.methods):
        for write in function.writes:
            value = getattr(write.node, "value", None)
            if isinstance(write.node, (ast.Assign, ast.AnnAssign)) and value is not None and _has_bound(value):
                bounded.add(write.attribute)
    return {attribute for attribute in bounded if attribute is not None}


def _is_first(attribute: str | None, node: ast.AST, function: Function) -> bool:
    """Tell whether a statement only makes the entry that is lacking: it stands under `if env not in self.frames`."""
    return any(
        isinstance(outer, ast.If)
        and isinstance(outer.test, ast.Compare)
        and isinstance(outer.test.ops[0], ast.NotIn)
        and self_attribute(outer.test.comparators[0]) == attribute
        for outer in enclosing(node, function.up)
    )


def _has_bound(value: ast.expr) -> bool:
    """Tell whether a value is a container with a largest size, or one that code elsewhere makes."""
    for node in ast.walk(value):
        if last(called(node)) == "deque" and isinstance(node, ast.Call):
            bounds = [entry.value for entry in node.keywords if entry.arg == "maxlen"] + node.args[1:]
            return any(constant(bound) is not None for bound in bounds)
        if isinstance(node, ast.keyword) and node.arg in {"maxlen", "maxsize"}:
            return True
    made = last(called(value))
    return bool(made) and made not in {"list", "defaultdict", "dict"}


def _is_bounded_here(node: ast.AST, function: Function, attribute: str) -> bool:
    """Tell whether entries are added only below some length, or are those of a `maxlen` that is made on the way."""
    if "maxlen" in ast.unparse(node):
        return True
    for outer in enclosing(node, function.up):
        if isinstance(outer, (ast.If, ast.While)):
            words = {child.attr for child in ast.walk(outer.test) if isinstance(child, ast.Attribute)}
            if attribute in words or any("debug" in word or "record" in word or "log" in word for word in words):
                return True
    return False
