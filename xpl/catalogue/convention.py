"""A convention: a choice that an adapter and its model have to share, with its conversion and its common mistakes.

Each is one module with an object `CONVENTION`. Built-in conventions are the modules of `xpl.conventions`; an installed
package adds its own by an entry point of the group `xpl.conventions`, whose value is such a module. Conversions, the
schema of the block, the search for mistakes, `xpl data probe`, the pages and `xpl explain` read only `CONVENTION`.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, Callable

from xpl import registry
from xpl.catalogue.mistake import AdapterCase, Mistake
from xpl.contract import Entry

if TYPE_CHECKING:
    import numpy as np

    from xpl.catalogue.part import Part

MistakeSource = Callable[[AdapterCase], Iterable[Mistake]]
InputChange = Callable[[Any, Entry], Any]
"""Returns changed model inputs; arguments: the inputs, and a map with parameters."""


@dataclass(frozen=True)
class GeometryStep:
    """A geometric transform of an image: one of `steps` of an image input.

    Attributes:
        encode: (image (H, W, 3), parameters) -> image.
        undo: (image, parameters, (height, width) before the step) -> image of that size.
        shape: (parameters, (height, width) before) -> (height, width) after.
    """

    encode: Callable[[np.ndarray, Any], np.ndarray]
    undo: Callable[[np.ndarray, Any, tuple[int, int]], np.ndarray]
    shape: Callable[[Any, tuple[int, int]], tuple[int, int]] = lambda _how, before: before


@dataclass(frozen=True)
class ValueTransform:
    """A transform of values by one key of an entry, and its inverse.

    Attributes:
        encode: (the standard's value, value of the key) -> the model's value.
        decode: the inverse.
    """

    encode: Callable[[Any, Any], Any]
    decode: Callable[[Any, Any], Any]


def _none(_case: AdapterCase) -> Iterable[Mistake]:
    return ()


@dataclass(frozen=True)
class Convention:
    """One convention.

    Attributes:
        name: name in reference.py and in findings.
        about: one-line description; for built-in conventions the schema of the block has it.
        config_mistakes: its mistakes as edits of the model_io block.
        io_mistakes: its mistakes as changes of observations and actions.
        input_mistakes: its mistakes as changes of the inputs that the adapter's `encode` returns.
        input_changes: by kind of such a change, the function that applies it.
        steps: geometric transforms of images, by their key.
        images: by key of an image input, its transform of images (..., H, W, 3), 0..255, after the steps.
        texts: by key of the instruction, its transform of the text, before the template.
        parts: by key, the classes of parts of a vector.
        keys: keys of the block that belong to it, by group: images, steps, history, normalize, vectors, a kind of
            part, or block for top-level keys; `*` for all keys of a group.
        applies: returns whether it applies to a block; by default if one of its keys is present.
        schema: properties that it adds to the schema of the block, by definition.
        probe: yields evidence of it in a data set, from a `xpl_cli.data.probe.sample.Sample`.
    """

    name: str
    about: str = ""
    config_mistakes: MistakeSource = _none
    io_mistakes: MistakeSource = _none
    input_mistakes: MistakeSource = _none
    input_changes: Mapping[str, InputChange] = field(default_factory=dict)
    steps: Mapping[str, GeometryStep] = field(default_factory=dict)
    images: Mapping[str, ValueTransform] = field(default_factory=dict)
    texts: Mapping[str, ValueTransform] = field(default_factory=dict)
    parts: Mapping[str, type[Part]] = field(default_factory=dict)
    keys: Mapping[str, Sequence[str]] = field(default_factory=dict)
    applies: Callable[[Entry], bool] | None = None
    schema: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    probe: Callable[[Any], Iterable[Any]] | None = None


@cache
def built_in() -> tuple[Convention, ...]:
    """Return the built-in conventions, by name."""
    folder = importlib.import_module("xpl.conventions")
    modules = (importlib.import_module(f"xpl.conventions.{one.name}") for one in pkgutil.iter_modules(folder.__path__))
    return tuple(module.CONVENTION for module in modules)


@cache
def installed() -> tuple[Convention, ...]:
    """Return the conventions of installed packages.

    Raises:
        EntryPointError: one cannot be imported, or is no convention.
    """
    found = []
    for entry in registry.entries(registry.CONVENTIONS).values():
        one = getattr(entry.load(), "CONVENTION", None)
        if not isinstance(one, Convention):
            raise entry.unusable("it has no CONVENTION, an object of xpl.catalogue.Convention")
        found.append(one)
    return tuple(found)


def conventions() -> tuple[Convention, ...]:
    """Return all conventions: built-in, then those of installed packages."""
    return (*built_in(), *installed())


def lookup(kind: str, word: str) -> Any:
    """Return the value of a key in a map of the conventions, built-in ones first; None if no convention has it.

    Args:
        kind: the map, an attribute of `Convention`: steps, images, texts, parts, input_changes.
        word: the key.
    """
    for source in (built_in, installed):  # installed packages are searched only if no built-in convention has it
        for one in source():
            if word in getattr(one, kind):
                return getattr(one, kind)[word]
    return None


def applying(block: Entry) -> list[str]:
    """Return the names of the conventions that apply to a block, sorted."""
    present = set(_keys_of(block, ()))
    return sorted(one.name for one in conventions() if (one.applies(block) if one.applies else _has_key(one, present)))


def convention_of_key(path: Sequence[str | int]) -> str | None:
    """Return the name of the convention that a path of the block belongs to, or None."""
    group, key = _group_of_key([word for word in path if isinstance(word, str)])
    by_key = _conventions_by_key()
    return by_key.get((group, key)) or by_key.get((group, "*"))


def _group_of_key(words: Sequence[str]) -> tuple[str, str]:
    """Return (group, key) of the keys that lead to a value."""
    *above, key = words
    for group in ("history", "normalize"):
        if group in above:
            return group, key
    if words[0] == "images":
        return ("steps" if "steps" in above else "images"), key
    if words[0] in ("state", "action"):
        return (above[-1] if "parts" in above else "vectors"), key
    return "block", words[0]


@cache
def _conventions_by_key() -> Mapping[tuple[str, str], str]:
    return {(group, key): one.name for one in conventions() for group, keys in one.keys.items() for key in keys}


def _keys_of(value: Any, path: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield (group, key) of all keys of a block."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield _group_of_key((*path, key))
            yield from _keys_of(item, (*path, key))
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _keys_of(item, path)


def _has_key(one: Convention, present: set[tuple[str, str]]) -> bool:
    return any((group, key) in present for group, keys in one.keys.items() for key in keys)


def kinds(block: Entry) -> set[str]:
    """Return the kinds of the parts that a block has."""
    vectors = [*_list(block.get("state")), block.get("action") or {}]
    return {kind for vector in vectors for part in _list(vector.get("parts")) for kind in part}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    """Yield mistakes as edits of the block, the likeliest first; whether the result is valid is not checked."""
    mistakes = [mistake for one in conventions() for mistake in one.config_mistakes(case)]
    yield from sorted(mistakes, key=lambda one: one.rank)


def io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    """Yield mistakes as changes of observations and actions, the likeliest first, then those that need no rollout."""
    mistakes = [mistake for one in conventions() for mistake in one.io_mistakes(case)]
    yield from sorted(mistakes, key=lambda one: (one.rank, one.change_observations is not None, one.windowed))


def input_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    """Yield mistakes as changes of model inputs, the likeliest first, those that resize images last."""
    mistakes = [mistake for one in conventions() for mistake in one.input_mistakes(case)]
    yield from sorted(mistakes, key=lambda one: (one.rank, bool(one.geometry)))
