"""The entry of an observation or a trajectory that an expression reads, if its keys are constants."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.audit.static.syntax import constant, targets

if TYPE_CHECKING:
    from xpl_cli.audit.static.function import Function

Path = tuple[str | None, ...]
"""Keys from the outermost to the innermost; None for a key that is computed at run time."""

GROUPS: Final = frozenset((sdk.Obs.VISION, sdk.Obs.STATE, "action"))
_NEAR: Final = 0.85
_DEEPEST: Final = 8


@dataclass(frozen=True)
class LeafRead:
    """An expression that reads a leaf: `data["state"]["ee_pose"]`, `camera.get("color")`, `root["/state/ee_pose"]`.

    Attributes:
        node: the expression.
        key: the expression of its last key.
        group: `vision`, `state` or `action`.
        name: the leaf.
        required: whether its absence raises.
    """

    node: ast.expr
    key: ast.expr
    group: str
    name: str
    required: bool


def leaf_reads(function: Function) -> Iterator[LeafRead]:
    """Yield the leaves that a function reads by a constant name."""
    reads = [read for node in function.of(ast.Subscript, ast.Call) if (read := _read(node)) is not None]
    if not reads:
        return
    origins = _origins(function)
    for owner, key, node in reads:
        path = (*_path(owner, origins), *_keys(key))
        group = next((name for name in path if name in GROUPS), None)
        if group is None:
            continue
        below = path[path.index(group) + 1 :]
        leaf = below[-1] if len(below) == (2 if group == sdk.Obs.VISION else 1) else None
        if leaf is not None:
            yield LeafRead(node, key, group, leaf, required=isinstance(node, ast.Subscript))


def closest_name(name: str, valid_names: Iterable[str]) -> str | None:
    """Return the valid name that a name resembles; None if it is valid itself or resembles none."""
    valid_names = tuple(valid_names)
    matches = difflib.get_close_matches(name, valid_names, n=1, cutoff=_NEAR)
    return matches[0] if matches and name not in valid_names else None


def is_number(name: str, other: str) -> bool:
    """Return whether two names are singular and plural of one word."""
    return name.removesuffix("s") == other.removesuffix("s")


def _read(node: ast.AST) -> tuple[ast.expr, ast.expr, ast.expr] | None:
    """Return owner, key and node of a look-up that reads."""
    if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Load):
        return node.value, node.slice, node
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get" and node.args:
        return node.func.value, node.args[0], node
    return None


def _keys(key: ast.expr) -> Path:
    """Return the keys of one look-up; a path of HDF5 holds several."""
    if isinstance(key, ast.JoinedStr):
        text = "".join(str(part.value) if isinstance(part, ast.Constant) else "\0" for part in key.values)
        return tuple(None if "\0" in part else part for part in text.strip("/").split("/"))
    value = constant(key)
    return tuple(value.strip("/").split("/")) if isinstance(value, str) else (None,)


def _path(node: ast.expr, origins: dict[str, tuple[ast.expr, Path]], depth: int = 0) -> Path:
    if depth > _DEEPEST:
        return ()
    if isinstance(node, ast.Name):
        if node.id in origins:
            origin, more = origins[node.id]
            return (*_path(origin, origins, depth + 1), *more)
        return (node.id,) if node.id in GROUPS else ()
    read = _read(node)
    if read is None or isinstance(read[1], ast.Slice):
        return ()
    outer = _path(read[0], origins, depth + 1)
    keys = _keys(read[1])
    return (*outer, *keys) if outer or keys[0] in GROUPS else ()


def _origins(function: Function) -> dict[str, tuple[ast.expr, Path]]:
    """Return the expression and keys that each local name was assigned from. Loops read any entry."""
    origins: dict[str, tuple[ast.expr, Path]] = {}
    for node in function.of(ast.Assign, ast.For, ast.comprehension):
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            origins[node.targets[0].id] = (node.value, ())
        elif isinstance(node, (ast.For, ast.comprehension)) and isinstance(node.iter, ast.Call):
            taken = node.iter.func
            if isinstance(taken, ast.Attribute) and taken.attr in {"values", "items"}:
                bound = targets(node) if isinstance(node, ast.For) else _flat(node.target)
                if bound and isinstance(bound[-1], ast.Name):
                    origins[bound[-1].id] = (taken.value, (None,))
    return origins


def _flat(target: ast.expr) -> list[ast.expr]:
    return list(target.elts) if isinstance(target, ast.Tuple) else [target]
