"""Expressions of an evaluation loop, followed on the syntax tree with stand-ins for everything outside of it.

Nothing of the adapter runs: numbers, lists and maps that the loop keeps books with are computed here, within narrow
limits, and every other value is opaque. Where an opaque value decides, `Choices` decides in its place.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Final

from xpl_cli.audit.static.loops.world import Opaque, Token, changed

LARGEST: Final = 100_000
"""Numbers beyond this are not computed with."""
LONGEST: Final = 5000
"""Entries of a list that are looked at; loops end long before."""
_MUTATING: Final = frozenset(("update", "pop", "popitem", "setdefault", "clear", "__setitem__"))
_METHODS: Final[dict[type, frozenset[str]]] = {
    list: frozenset(
        ("append", "extend", "insert", "pop", "remove", "clear", "copy", "index", "count", "sort", "reverse")
    ),
    dict: frozenset(("get", "items", "keys", "values", "pop", "setdefault", "update", "copy", "clear")),
    set: frozenset(
        ("add", "discard", "remove", "update", "clear", "copy", "union", "intersection", "difference", "issubset")
    ),
    tuple: frozenset(("index", "count")),
}
_OPERATORS: Final[dict[type[ast.AST], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
}


class Unclear(Exception):  # noqa: N818 - an answer, not a fault of this program
    """The loop does something that cannot be followed; the argument says what."""


class Raised(Exception):  # noqa: N818 - the adapter's error, not one of this program
    """The loop raises."""


@dataclass
class Choices:
    """What opaque conditions are taken for, each place in the code the same way in a whole evaluation.

    Attributes:
        given: for the first places, in the order in which they are met; True for all further ones.
        made: what was chosen, by place.
    """

    given: tuple[bool, ...] = ()
    made: dict[int, bool] = field(default_factory=dict)

    def of(self, node: ast.AST) -> bool:
        """Return what an opaque condition is taken for."""
        place = len(self.made)
        return self.made.setdefault(id(node), self.given[place] if place < len(self.given) else True)

    def next(self) -> Choices | None:
        """Return the next combination, None after the last one."""
        made = list(self.made.values())
        while made and not made[-1]:
            made.pop()
        return Choices((*made[:-1], False)) if made else None


def built_in(name: str) -> Callable[..., Any] | None:
    """Return a function of the language, as far as a loop may use it here."""
    return _BUILT_IN.get(name)


def binary(node: ast.AST, left: Any, right: Any) -> Any:
    """Return the value of an operator, opaque unless both sides are known."""
    if isinstance(node, (ast.In, ast.NotIn)):
        found = _contains(right, left)
        return found is isinstance(node, ast.In) if isinstance(found, bool) else found
    sides = (left, right)
    is_same = isinstance(node, (ast.Is, ast.IsNot)) or None in sides
    if isinstance(node, (ast.Is, ast.IsNot, ast.Eq, ast.NotEq)) and is_same:
        is_known = all(type(side) is not Opaque for side in sides)
        return _OPERATORS[type(node)](left, right) if is_known else Opaque()
    if any(isinstance(side, Opaque) for side in sides):
        return Opaque() if isinstance(node, ast.cmpop) else changed(left if isinstance(left, Token) else right)
    return _computed(node, left, right)


def _computed(node: ast.AST, left: Any, right: Any) -> Any:
    function = _OPERATORS.get(type(node))
    is_repeated = isinstance(node, ast.Mult) and not (_is_number(left) and _is_number(right))
    if function is None or is_repeated or (isinstance(node, ast.Mod) and isinstance(left, str)):
        return Opaque()
    try:
        return small(function(left, right))
    except (TypeError, ArithmeticError, ValueError):
        return Opaque()


def small(value: Any) -> Any:
    """Return a value.

    Raises:
        Unclear: if it is larger than bookkeeping needs.
    """
    if (_is_number(value) and abs(value) > LARGEST) or (hasattr(value, "__len__") and len(value) > LONGEST):
        raise Unclear("it computes with large numbers")
    return value


def item(owner: Any, key: Any) -> Any:
    """Return `owner[key]`."""
    if isinstance(owner, Opaque):
        return Opaque(owner.root)
    if isinstance(key, Opaque) or isinstance(owner, (set, type(None))):
        return Opaque()
    try:
        return owner[key]
    except (LookupError, TypeError):
        raise Raised from None


def method(owner: Any, name: str, given: list[Any], named: dict[str, Any]) -> Any:
    """Return what a method of a value answers."""
    if isinstance(owner, Opaque):
        if name == "copy" and isinstance(owner, Token):
            return owner.copy()
        if name in _MUTATING and owner.root is not None:
            owner.root.changed = True
        return Opaque(owner.root)
    if name not in _METHODS.get(type(owner), ()):
        return Opaque()
    try:
        return small(getattr(owner, name)(*given, **named))
    except (LookupError, TypeError, ValueError):
        raise Raised from None


def store(owner: Any, key: Any, value: Any) -> None:
    """Do `owner[key] = value`."""
    if isinstance(owner, Opaque):
        if owner.root is not None:
            owner.root.changed = True
    elif isinstance(owner, (list, dict)) and not isinstance(key, Opaque):
        try:
            owner[key] = value
        except (LookupError, TypeError, ValueError):
            raise Raised from None


def entries(value: Any) -> list[Any] | None:
    """Return what a loop over a value goes through, None where nobody knows."""
    if isinstance(value, Opaque) or value is None or isinstance(value, (int, float)):
        return None
    try:
        return list(islice(value, LONGEST))
    except TypeError:
        return None


def _contains(owner: Any, value: Any) -> Any:
    if isinstance(owner, Opaque) or isinstance(value, Opaque):
        return Opaque()
    try:
        return value in owner
    except TypeError:
        return Opaque()


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float))


def _known(values: Iterable[Any]) -> Iterator[Any]:
    for value in values:
        if isinstance(value, Opaque) and not isinstance(value, Token):
            raise _NotKnown
        yield value


class _NotKnown(Exception):  # noqa: N818 - becomes an opaque value
    """A function of the language is given something opaque."""


def plain(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of the language that answers an opaque value where it is given one."""

    def call(*given: Any, **named: Any) -> Any:
        try:
            return small(function(*_known(given), **named))
        except _NotKnown:
            return Opaque(next((value.root for value in given if isinstance(value, Opaque)), None))
        except (TypeError, ValueError, ArithmeticError):
            return Opaque()
        except (LookupError, StopIteration):
            raise Raised from None

    return call


def _listed(function: Callable[..., Iterable[Any]]) -> Callable[..., Any]:
    return plain(lambda *given, **named: list(islice(function(*given, **named), LONGEST)))


def _same(value: Any = None, *_: Any, **__: Any) -> Any:
    """Return what hands on what it gets: `tqdm(chunk)`, `list(chunk)`, `np.asarray(chunk)`."""
    if isinstance(value, Token):
        return value.copy()
    return list(value) if isinstance(value, (list, tuple, set, dict, range)) else value


def _dict(*given: Any, **named: Any) -> Any:
    if given and isinstance(given[0], Token):
        return given[0].copy(changed=bool(named))
    return plain(dict)(*given, **named)


_PLAIN: Final[tuple[Callable[..., Any], ...]] = (len, sum, any, all, min, max, abs, int, bool, set, tuple, next, iter)
_LISTED: Final[tuple[Callable[..., Any], ...]] = (range, zip, enumerate, sorted, reversed, map, filter)

_BUILT_IN: Final[dict[str, Callable[..., Any]]] = {
    **{function.__name__: plain(function) for function in _PLAIN},
    **{function.__name__: _listed(function) for function in _LISTED},
    **dict.fromkeys(("list", "tqdm", "track", "asarray", "array", "deepcopy", "copy"), _same),
    "dict": _dict,
}
