"""XPL115: reset clears all state of an episode."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.episode_state import is_memo, mentioned_attributes, read_attributes
from xpl_cli.audit.static.function import Function, Write, writes
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, RESET, RESETTING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, is_conditional, self_attribute, targets

_FIX = Fix("advice", "set these attributes in reset, or derive from xpl.Policy, which stores and clears them")


@rule(code="XPL115", requirement="XPL-EPI-1")
def reset_incomplete(source: Source) -> Iterator[Finding]:
    """State of an episode survives reset.

    ## What it does
    Collects the attributes that `update_obs` and `get_action` modify and read, and compares them with those that
    `reset` sets or clears, in the class itself and in its attributes that are objects of the adapter's own classes. Not
    reported: caches (filled only if an entry is missing), values that are set again before each use, and attributes
    that are emptied before the method returns.

    ## Why it matters
    The first action of an episode is then computed from the last observation of the previous episode, often of another
    scene. Results depend on the order of the episodes and cannot be reproduced.

    ## Example
    `update_obs_batch` fills `self.batch`, but `reset` clears only `self.latest`.

    ## Use instead
    Derive from `xpl.Policy`; or set every such attribute in one method that `__init__` and `reset` both call.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    reset = adapter.method(RESET) or adapter.method(RESETTING[-1])
    resetting = adapter.reach(*RESETTING)
    if not adapter.is_closed and reset is None:
        return  # a base class that is not here resets
    if any(_resets_all(function, adapter) for function in resetting):
        return
    acting = adapter.reach(*OBSERVING, *ACTING)
    left = _left(acting, mentioned_attributes(resetting))
    for attribute, component in adapter.components.items():
        left |= {f"{attribute}.{name}": write for name, write in _left_in(adapter, attribute, component).items()}
    if not left:
        return
    first = next(iter(left.values()))
    where = source.start(*((reset.file, reset.node) if reset is not None else (adapter.file, adapter.node)))
    yield Finding(
        f"{RESET} leaves {' and '.join(f'self.{name}' for name in left)} as the previous episode set it: the "
        "next episode may start with its observation or plan",
        **where,
        expected=f"{RESET} sets it anew",
        got=f"{first.function.name} sets it in line {first.line}",
        evidence={name: f"{write.function.name}:{write.line}" for name, write in left.items()},
        fix=_FIX,
    )


def _left(acting: list[Function], forgotten: set[str]) -> dict[str, Write]:
    """Return the attributes that these functions remember and that are not among the forgotten."""
    used = read_attributes(acting)
    loading = set(LOADING) | set(RESETTING)
    first_writes: dict[str, Write] = {}
    for write in writes([function for function in acting if function.name not in loading]):
        if write.attribute in used and write.attribute not in forgotten and not is_memo(write):
            first_writes.setdefault(write.attribute, write)
    return {
        name: write
        for name, write in first_writes.items()
        if not _is_temporary(name, acting)
        and not _is_guarded(write, used & forgotten)
        and not _is_drained(name, acting)
    }


def _is_guarded(write: Write, cleared: set[str]) -> bool:
    """Tell whether an attribute cannot be used before it is set anew.

    That is so if it is always set together with another one which reset does clear and which actions need too.
    """
    function = write.function
    together = {other.attribute for other in writes([function]) if other.kind != "grown"}
    always = write.kind == "assigned" and not is_conditional(write.node, function.node, function.up)
    return always and bool(together & cleared)


def _is_drained(attribute: str, functions: list[Function]) -> bool:
    """Tell whether whatever fills an attribute empties it again before it ends, so that nothing is left in it."""
    filling = {id(write.function.node): write.function for write in writes(functions) if write.attribute == attribute}
    return bool(filling) and all(_empties(attribute, function) for function in filling.values())


def _empties(attribute: str, function: Function) -> bool:
    filled = [write.line for write in writes([function]) if write.attribute == attribute and not _is_empty(write.node)]
    emptied = [0]
    nodes: list[ast.Assign | ast.Call | ast.While] = [*function.of(ast.Assign), *function.of(ast.Call)]
    for node in [*nodes, *function.of(ast.While)]:
        if isinstance(node, ast.While):
            is_emptying = self_attribute(node.test) == attribute
        elif is_conditional(node, function.node, function.up):
            is_emptying = False
        elif isinstance(node, ast.Assign):
            is_emptying = _is_empty(node) and attribute in map(self_attribute, targets(node))
        else:
            is_emptying = called(node) == f"self.{attribute}.clear"
        emptied += [node.lineno] if is_emptying else []
    return max(emptied) > max(filled, default=0)


def _is_empty(node: ast.AST) -> bool:
    """Tell whether a statement puts nothing into what it sets: None, or a container without entries."""
    value = getattr(node, "value", None)
    if not isinstance(node, (ast.Assign, ast.AnnAssign)):
        return False
    if isinstance(value, (ast.List, ast.Dict, ast.Tuple)):
        return not any(isinstance(child, ast.expr) for child in ast.iter_child_nodes(value))
    made = isinstance(value, ast.Call) and called(value) in {"list", "dict", "set", "deque", "collections.deque"}
    return (isinstance(value, ast.Constant) and value.value is None) or (made and not getattr(value, "args", None))


def _left_in(adapter: ModelClass, attribute: str, component: ModelClass) -> dict[str, Write]:
    """Return what an object of the adapter's own classes remembers of an episode and nobody clears."""
    acting = _calls_on(adapter.reach(*OBSERVING, *ACTING), attribute)
    resetting = adapter.reach(*RESETTING)
    forgotten = mentioned_attributes(component.reach(*_calls_on(resetting, attribute)))
    for function in resetting:
        for node in function.nodes:
            for target in targets(node):
                if self_attribute(target) == attribute and isinstance(target, ast.Attribute):
                    if isinstance(target.value, ast.Name):
                        return {}  # the object itself is made anew
                    forgotten.add(target.attr)
            if (
                isinstance(node, ast.Call)
                and self_attribute(node.func) == attribute
                and isinstance(node.func, ast.Attribute)
            ):
                if isinstance(node.func.value, ast.Attribute):
                    forgotten.add(node.func.value.attr)
                if (
                    node.func.attr not in component.methods
                    and isinstance(node.func.value, ast.Attribute)
                    and (node.func.value.attr == attribute)
                ):
                    return {}  # an inherited method may reset anything
    return _left(component.reach(*acting), forgotten)


def _calls_on(functions: list[Function], attribute: str) -> list[str]:
    """Return the methods of `self.<attribute>` that these functions call."""
    return [
        node.func.attr
        for function in functions
        for node in function.nodes
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and isinstance(node.func.value, ast.Attribute)
        and node.func.value.attr == attribute
        and self_attribute(node.func.value) == attribute
    ]


def _is_temporary(attribute: str, functions: list[Function]) -> bool:
    """Tell whether an attribute is set anew, whatever happens, before anything of the same method reads it."""
    for function in functions:
        lines = [
            node.lineno
            for node in function.nodes
            if isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Load)
            and self_attribute(node) == node.attr == attribute
        ]
        if not lines:
            continue
        set_at = [
            write.line
            for write in writes([function])
            if write.attribute == attribute
            and write.kind == "assigned"
            and not is_conditional(write.node, function.node, function.up)
        ]
        if not set_at or min(set_at) >= min(lines):
            return False
    return True


def _resets_all(function: Function, adapter: ModelClass) -> bool:
    """Tell whether a reset clears everything at once, or hands over to a class that is not here."""
    for node in function.nodes:
        name = called(node)
        if name in {"self.__init__", "__init__", "self.__dict__.clear"}:
            return True
        if name in {"setattr", "vars"} and isinstance(node, ast.Call) and any(map(_is_self, node.args[:1])):
            return True
        if isinstance(node, ast.Attribute) and node.attr == "__dict__" and _is_self(node.value):
            return True
        if name == "super" and not adapter.is_closed:
            return True
    return False


def _is_self(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id == "self"
