"""What a method of an adapter answers, as far as its code shows: a map with known keys, or a list of something."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.syntax import called, constant, targets

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.static.function import Function
    from xpl_cli.audit.static.model_class import ModelClass

_DEEPEST: Final = 12


@dataclass(frozen=True)
class MapAnswer:
    """A map.

    Attributes:
        keys: its constant keys.
        is_complete: whether it has no other keys.
        function, node: where it is made.
    """

    keys: frozenset[str]
    is_complete: bool
    function: Function
    node: ast.expr


@dataclass(frozen=True)
class ListAnswer:
    """A list; `item` is what each entry is, None if the code does not show it."""

    item: Answer | None


Answer = MapAnswer | ListAnswer


def returned(adapter: ModelClass, function: Function) -> Iterator[Answer]:
    """Yield what the returns of a function are, where the code shows it."""
    for node in function.of(ast.Return):
        answer = _of(adapter, function, node.value, 0) if node.value is not None else None
        if answer is not None:
            yield answer


def _of(adapter: ModelClass, function: Function, value: ast.expr, depth: int) -> Answer | None:
    found: Answer | None = None
    if depth > _DEEPEST:
        pass
    elif isinstance(value, ast.Dict):
        found = _map(function, value, [None if key is None else constant(key) for key in value.keys])
    elif isinstance(value, (ast.ListComp, ast.GeneratorExp)):
        found = ListAnswer(_of(adapter, function, value.elt, depth + 1))
    elif isinstance(value, (ast.List, ast.Tuple)):
        found = ListAnswer(_of(adapter, function, value.elts[0], depth + 1) if value.elts else None)
    elif isinstance(value, ast.Name):
        found = _of_name(adapter, function, value.id, depth + 1)
    elif isinstance(value, ast.Subscript):
        owner = _of(adapter, function, value.value, depth + 1)
        if isinstance(owner, ListAnswer):
            found = owner if isinstance(value.slice, ast.Slice) else owner.item
    elif isinstance(value, ast.Call):
        found = _of_call(adapter, function, value, depth + 1)
    return found


def _map(function: Function, node: ast.expr, keys: list[object]) -> MapAnswer:
    known = frozenset(key for key in keys if isinstance(key, str))
    return MapAnswer(known, all(isinstance(key, str) for key in keys), function, node)


def _of_call(adapter: ModelClass, function: Function, call: ast.Call, depth: int) -> Answer | None:
    name = called(call)
    if name == "dict" and not call.args:
        return _map(function, call, [keyword.arg for keyword in call.keywords])
    if name == "list" and len(call.args) == 1:
        inner = _of(adapter, function, call.args[0], depth)
        return inner if isinstance(inner, ListAnswer) else ListAnswer(None)
    other = adapter.callee(function, call)
    if other is None:
        return None
    values = [node.value for node in other.of(ast.Return) if node.value is not None]
    return _agreed([_of(adapter, other, value, depth) for value in values])


def _of_name(adapter: ModelClass, function: Function, name: str, depth: int) -> Answer | None:
    """Return what all assignments of a local name agree on, with what is added to it afterwards."""
    values = [node.value for node in function.of(ast.Assign) for target in targets(node) if _is(target, name)]
    values += [node.value for node in function.of(ast.AnnAssign) if _is(node.target, name) and node.value is not None]
    found = _agreed([_of(adapter, function, value, depth) for value in values])
    if isinstance(found, MapAnswer):
        stored = [node for node in function.of(ast.Subscript) if _is(node.value, name) and _is_stored(node)]
        keys = [constant(node.slice) for node in stored]
        is_grown = any(
            isinstance(call.func, ast.Attribute)
            and call.func.attr in {"update", "setdefault"}
            and _is(call.func.value, name)
            for call in function.of(ast.Call)
        )
        whole = _map(found.function, found.node, [*found.keys, *keys])
        return MapAnswer(
            whole.keys, whole.is_complete and found.is_complete and not is_grown, found.function, found.node
        )
    if isinstance(found, ListAnswer) and found.item is None:
        added = [
            call.args[0]
            for call in function.of(ast.Call)
            if isinstance(call.func, ast.Attribute) and call.func.attr == "append" and _is(call.func.value, name)
        ]
        return ListAnswer(_agreed([_of(adapter, function, value, depth) for value in added]))
    return found


def _is(node: ast.expr, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _is_stored(node: ast.Subscript) -> bool:
    return isinstance(node.ctx, ast.Store)


def _agreed(answers: list[Answer | None]) -> Answer | None:
    """Return the answer that all are alike, of maps one with the keys of all; None if they differ."""
    if not answers or any(answer is None for answer in answers):
        return None
    maps = [answer for answer in answers if isinstance(answer, MapAnswer)]
    if len(maps) == len(answers):
        keys = frozenset().union(*(one.keys for one in maps))
        return MapAnswer(keys, all(one.is_complete for one in maps), maps[-1].function, maps[-1].node)
    lists = [answer for answer in answers if isinstance(answer, ListAnswer)]
    if len(lists) < len(answers):
        return None
    items = [one.item for one in lists if one.item is not None]
    return ListAnswer(_agreed(list(items)) if items else None)
