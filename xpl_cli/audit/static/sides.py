"""Conversions that have two sides: what is done to observed values going in is undone in answers going out."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.static.adapter import ACTING, OBSERVING
from xpl_cli.audit.static.syntax import enclosing, targets

if TYPE_CHECKING:
    from xpl_cli.audit.static.adapter import Adapter
    from xpl_cli.audit.static.function import Function

IN, OUT = "in", "out"
_OBSERVED: Final = re.compile(r"obs|observation|state|qpos|proprio\w*|current")
_ANSWERED: Final = re.compile(r"actions?|act|raw|pred\w*|chunks?|outputs?|out|command|target|answer|decode|unpack")
_WORD: Final = re.compile(r"[a-z]+")


@dataclass(frozen=True)
class Conversion:
    """A place where a value is converted.

    Attributes:
        node: the expression.
        side: `in` for observed values, `out` for answers, "" where the code does not say.
        kind: what it does, in the words of who looks for it.
    """

    function: Function
    node: ast.expr
    side: str
    kind: str


def conversions(adapter: Adapter, kind_of: Callable[[ast.AST, Function], str | None]) -> Iterator[Conversion]:
    """Yield the conversions of what observing and acting reach.

    Args:
        adapter: the class.
        kind_of: returns what kind of conversion a node is, None for all others.
    """
    for function in adapter.reach(*OBSERVING, *ACTING):
        for node in function.nodes:
            kind = kind_of(node, function)
            if kind is not None and isinstance(node, ast.expr):
                yield Conversion(function, node, _side(node, function), kind)


def words(node: ast.AST) -> set[str]:
    """Return the words of all names, attributes and texts below a node, in small letters."""
    found: set[str] = set()
    for child in ast.walk(node):
        value = getattr(child, "id", None) or getattr(child, "attr", None) or getattr(child, "value", None)
        if isinstance(value, str):
            found.update(_WORD.findall(value.lower()))
    return found


def _side(node: ast.expr, function: Function) -> str:
    """Tell by the words of the expression, then of what it is assigned to, then of the function."""
    statement = next((entry for entry in enclosing(node, function.up) if isinstance(entry, ast.stmt)), node)
    name = set(_WORD.findall(function.name.lower()))
    for group in (words(node), {word for target in targets(statement) for word in words(target)}, name):
        is_in = any(map(_OBSERVED.fullmatch, group)) or "encode" in group
        is_out = any(map(_ANSWERED.fullmatch, group))
        if is_in != is_out:
            return IN if is_in else OUT
    return ""
