"""Changes of the fields of an arm: there and back, and what they do to differences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from xpl.contract import State
from xpl.convert.parts import Numbers

Fields = State
"""The map `state` of an observation, or an action step."""
Turn = Callable[[Fields], dict[str, Numbers]]
Function = Callable[[Numbers], Numbers]


@dataclass(frozen=True)
class Change:
    """Another way to write the fields of an arm.

    Attributes:
        rank: 0 for the likeliest.
        words: what the model means.
        convention: of the vocabulary.
        there: the standard's fields as the model writes them.
        back: the inverse.
        delta: `back` of differences; None where differences have no such way.
        ways: which ways are tried: state, action, both.
    """

    rank: int
    words: str
    convention: str
    there: Turn
    back: Turn
    delta: Turn | None
    ways: tuple[str, ...] = ("both", "state", "action")

    def inverse(self, words: str, delta: Turn | None = None, rank: int | None = None) -> Change:
        """Return the change in the other direction."""
        found = replace(self, words=words, there=self.back, back=self.there, delta=delta)
        return found if rank is None else replace(found, rank=rank)


def on(keys: Iterable[str], function: Function) -> Turn:
    """Return the change of these fields, where they are there, by a function of (..., width) float64."""
    chosen = frozenset(keys)

    def turn(fields: Fields) -> dict[str, Numbers]:
        return {key: _like(value, function) if key in chosen else value for key, value in fields.items()}

    return turn


def _like(value: Any, function: Function) -> Numbers:
    array = np.asarray(value)
    result = function(array.astype(np.float64))
    return result.astype(array.dtype) if array.dtype.kind == "f" else result


def exchanged(pairs: Mapping[str, str]) -> Turn:
    """Return the change that gives fields each other's values."""

    def turn(fields: Fields) -> dict[str, Numbers]:
        other = {**pairs, **{value: key for key, value in pairs.items()}}
        return {key: fields.get(other.get(key, key), value) for key, value in fields.items()}

    return turn


def same(fields: Fields) -> dict[str, Numbers]:
    """Change nothing."""
    return dict(fields)


def scopes(prefixes: Sequence[str]) -> list[tuple[int, str, tuple[str, ...]]]:
    """Return all arms together, then each alone: how much later it is tried, how it is called, its prefixes."""
    found = [(0, "", tuple(prefixes))]
    if len(prefixes) > 1:
        found += [(1, f" {prefix.rstrip('_')}", (prefix,)) for prefix in prefixes]
    return found
