"""What was put into a thing: the arguments of a call, by environment where they are a batch; and what is remembered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from xpl.worker.standins.facts import ANSWERS, ENCODERS, TRANSFORMS

_MOST = 64
"""Environments of a batch; a longer first axis is something else."""
_CHANNELS = (1, 3, 4)
_TELLING = {"text", "image"}
"""What a model goes on with from an earlier call, where a call has none of it."""


class Memory:
    """What an object was given since it was reset.

    Attributes:
        given: calls with data, the newest last; one of each name.
        rows: what was given for an environment, by its number, where numbers came with it.
        owner: the object.
    """

    def __init__(self) -> None:
        self.given: list[Given] = []
        self.rows: dict[int, Any] = {}
        self.owner: Any = None

    def clear(self) -> None:
        """Forget everything."""
        self.given, self.rows = [], {}

    def remember(self, given: Given) -> None:
        """Remember the newest call of each name, and what it says of each environment."""
        kinds = _kinds(given.values)
        kept = [other for other in self.given if other.verb != given.verb or _kinds(other.values) != kinds]
        self.given = [*kept, given]
        values = (*given.arguments, *given.named.values())
        numbers = next((numbers for numbers in map(_numbers, values) if numbers), None)
        if numbers is not None:
            for item in values:
                if (
                    isinstance(item, (list, tuple))
                    and item is not numbers
                    and len(item) == len(numbers)
                    and _numbers(item) is None
                ):
                    self.rows.update(zip(numbers, item))


class Given:
    """The arguments of a call.

    Attributes:
        verb: name of what was called.
        owner: name of what it was called on.
        arguments, named: what it was called with.
        alone: whether it is of one environment, however long the lists in it are.
        recalled: what the object was given before, for what the call itself does not say.
    """

    def __init__(
        self,
        verb: str,
        arguments: tuple[Any, ...],
        named: dict[str, Any],
        memory: Memory,
        before: Given | None = None,
        owner: str = "",
    ) -> None:
        self.verb, self.owner, self.arguments, self.named = verb, owner, arguments, named
        if before is not None:
            self.arguments = (before, *arguments)
        kinds = _kinds((arguments, named))
        self.alone = False
        self.recalled: list[Given] = []
        if not kinds:
            self.recalled = list(memory.given)
        elif ANSWERS.fullmatch(verb.lower()):
            lacking = _TELLING - kinds
            self.recalled = [other for other in memory.given if _kinds(other.values) & lacking][-1:]
        self.numbers = next((found for found in map(_numbers, (*arguments, *named.values())) if found), None)
        self.known = dict(memory.rows) if self.numbers and all(n in memory.rows for n in self.numbers) else {}

    @property
    def values(self) -> Any:
        """The arguments as one value."""
        return (self.arguments, self.named)

    @property
    def count(self) -> int | None:
        """How many environments the arguments are of, None if they are not a batch."""
        if self.alone:
            return None
        if self.known and self.numbers:
            return len(self.numbers)
        found = set(_counts(self.values, 0))
        if not found and self.recalled:
            return self.recalled[-1].count
        return found.pop() if len(found) == 1 and 0 < max(found) <= _MOST else None

    def shown(self, row: int | None) -> Any:
        """Return what one environment has to do with the call: nested maps and lists of arrays, numbers and texts."""
        if self.known and self.numbers is not None:
            return plain([self.known[self.numbers[row or 0]]], None, None)
        count = self.count
        mine = [plain(item, row, count) for item in self.arguments]
        named = {name: plain(item, row, count) for name, item in self.named.items()}
        return [mine, named, *(other.shown(row if other.count == count else None) for other in self.recalled)]

    def entry(self, keys: tuple[Any, ...]) -> Any:
        """Return what a transformation was given under some keys, None if there is no such entry or it is not one."""
        if not TRANSFORMS.fullmatch(self.verb.lower()):
            return None
        for value in (*self.arguments, *self.named.values()):
            found = _look_up(value, keys)
            if found is not None:
                return found
        return None

    def encoded(self) -> list[str] | None:
        """Return the keys of what a tokenizer or a processor of texts and images gives; None for any other call."""
        if not ENCODERS.search(f"{self.verb} {self.owner}".lower()):
            return None
        kinds = _kinds(self.values)
        texts = ["input_ids", "attention_mask"] if kinds & {"text", "word"} else []
        return [*texts, *(["pixel_values"] if "image" in kinds else [])] or None

    def is_of_image(self) -> bool:
        """Tell whether a transformation was given an image as libraries of images have them."""
        return bool(TRANSFORMS.fullmatch(self.verb.lower())) and any(is_image(value) for value in self.arguments)

    def keys(self, keys: tuple[Any, ...]) -> list[Any] | None:
        """Return the keys of the map that a transformation was given, None if there is no map."""
        if not TRANSFORMS.fullmatch(self.verb.lower()):
            return None
        for value in (*self.arguments, *self.named.values()):
            found = _look_up(value, keys) if keys else value
            if isinstance(found, Mapping):
                return list(found)
            inner = _origin(found)
            if inner is not None and inner.given is not None:
                below: list[Any] | None = inner.given.keys(inner.keys)
                return below
        return None


def is_data(value: Any, *, texts: bool) -> bool:
    """Tell whether a value holds anything that a model could be shown."""
    for leaf in _leaves(value, 0):
        if isinstance(leaf, (str, bytes)):
            if texts and leaf:
                return True
        elif not isinstance(leaf, (int, float, np.generic)):
            return True
    return False


def plain(value: Any, row: int | None, count: int | None) -> Any:
    """Return the data of a value, of one environment where it is a batch of `count`; what is no data is left out."""
    told = _origin(value)
    if isinstance(value, Given):
        return value.shown(row if value.count == count else None)
    if told is not None:
        if told.given is None:
            return None
        given = told.given
        return [
            given.shown(row if given.count == count and count is not None else None),
            [str(key) for key in told.keys],
        ]
    array = as_data(value)
    if array is not None:
        if getattr(value, "is_noise", False):
            return None
        mine = count is not None and row is not None and array.ndim >= 1 and array.shape[0] == count
        return array[row] if mine else array
    if isinstance(value, Mapping):
        return {str(key): plain(item, row, count) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        if count is not None and row is not None and len(value) == count and _is_listing(value):
            return plain(value[row], None, None)
        return [plain(item, row, count) for item in value]
    if isinstance(value, (str, bytes, bool, int, float, np.generic)):
        return value
    inner = getattr(value, "__dict__", None)
    if isinstance(inner, dict) and type(value).__module__ not in ("builtins", "random"):
        return {name: plain(item, row, count) for name, item in inner.items() if as_data(item) is not None}
    return None


def as_data(value: Any) -> np.ndarray | None:
    """Return an array, a tensor or an image as an array; None for anything else."""
    if isinstance(value, np.ndarray):
        return value if value.dtype != object else None
    if isinstance(value, type) or _origin(value) is not None:
        return None
    if hasattr(value, "is_noise"):
        array: np.ndarray = value.array
        return array
    if hasattr(value, "__array_interface__") and not isinstance(value, np.generic):
        return np.asarray(value)
    return None


def is_image(value: Any) -> bool:
    """Tell whether a value is an image of an image library, rather than an array."""
    return (
        hasattr(value, "__array_interface__")
        and not isinstance(value, (np.ndarray, np.generic))
        and _origin(value) is None
    )


def _origin(value: Any) -> Any:
    return getattr(value, "__dict__", {}).get("_xpl_origin") if not isinstance(value, type) else None


def _is_listing(value: Any) -> bool:
    """Tell whether a list is one of things rather than a row of numbers."""
    return not all(isinstance(item, (int, float)) for item in value)


def _numbers(value: Any) -> list[int] | None:
    """Return numbers of environments, if that is what a value is."""
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "iu":
        value = value.tolist()
    if isinstance(value, (list, tuple)) and value and all(isinstance(item, (int, np.integer)) for item in value):
        numbers = [int(item) for item in value]
        return numbers if len(set(numbers)) == len(numbers) else None
    return None


def _leaves(value: Any, depth: int) -> Iterator[Any]:
    if depth > 8:
        return
    told = _origin(value)
    if told is not None:
        if told.given is not None:
            yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _leaves(item, depth + 1)
    elif isinstance(value, (list, tuple, set)):
        for item in value:
            yield from _leaves(item, depth + 1)
    elif isinstance(value, (str, bytes, int, float, np.generic)) or is_image(value) or as_data(value) is not None:
        yield value


def _kinds(value: Any) -> set[str]:
    """Return which kinds of inputs a value holds: a text, an image, numbers."""
    found = set()
    for leaf in _leaves(value, 0):
        told = _origin(leaf)
        array = None if is_image(leaf) else as_data(leaf)
        if is_image(leaf):
            found.add("image")
        elif told is not None:
            found |= _kinds(told.given.values)
        elif isinstance(leaf, (str, bytes)):
            found.add("text" if " " in str(leaf) else "word")
        elif array is not None:
            found.add("image" if array.ndim >= 3 and max(array.shape[-3:]) >= 32 else "numbers")
    return found


def _counts(value: Any, depth: int) -> Iterator[int]:
    told = _origin(value)
    if told is not None:
        if told.given is not None and told.given.count is not None:
            yield told.given.count
        return
    if is_image(value):
        yield -1
        return
    array = as_data(value)
    if array is not None:
        if array.ndim == 3 and array.shape[-1] in _CHANNELS and array.shape[0] > _CHANNELS[-1]:
            yield -1  # one image
        elif array.ndim >= 2 or (array.ndim == 1 and depth > 1):
            yield int(array.shape[0])
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _counts(item, depth + 1)
    elif isinstance(value, Given):
        if value.count is not None:
            yield value.count
    elif isinstance(value, (list, tuple)):
        if depth > 1 and _is_listing(value) and value:
            yield len(value)
        else:
            for item in value:
                yield from _counts(item, depth + 1)


def _look_up(value: Any, keys: tuple[Any, ...]) -> Any:
    for key in keys:
        told = _origin(value)
        if told is not None:
            return value[key] if told.given is not None and len(keys) == 1 else None
        if not isinstance(value, Mapping) or key not in value:
            return None
        value = value[key]
    return value
