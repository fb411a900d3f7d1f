"""A convention: a choice that an adapter and its model have to share, with its code and its usual mistakes.

Each is one module with an object `CONVENTION`: ours are the modules of `xpl.conventions`, which are found by their
folder, and an installed package adds its own by an entry point of `xpl.conventions`, whose value is such a module. What
is in `CONVENTION` is all that conversions, the schema of the block, the search for mistakes, the probe of a data set,
the pages and `xpl explain` know of it.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, Callable

from xpl import registry
from xpl.catalogue.mistake import Case, Mistake
from xpl.contract import Entry

if TYPE_CHECKING:
    import numpy as np

    from xpl.catalogue.part import Part

Finds = Callable[[Case], Iterable[Mistake]]
Change = Callable[[Any, Entry], Any]
"""Returns encoded inputs changed, of these and a map that says how."""


@dataclass(frozen=True)
class Step:
    """A change of an image's geometry: one of `steps` of an image input.

    Attributes:
        encode: images (..., H, W, 3) and how, to images.
        undo: images, how, and height and width before the step, to images of that size.
        shape: how, and height and width before, to those after.
    """

    encode: Callable[[np.ndarray, Any], np.ndarray]
    undo: Callable[[np.ndarray, Any, tuple[int, int]], np.ndarray]
    shape: Callable[[Any, tuple[int, int]], tuple[int, int]] = lambda _how, before: before


@dataclass(frozen=True)
class Stage:
    """What a key of an entry does to its values, there and back.

    Attributes:
        encode: the standard's value and what the key says, to the model's.
        decode: the inverse.
    """

    encode: Callable[[Any, Any], Any]
    decode: Callable[[Any, Any], Any]


def _none(_case: Case) -> Iterable[Mistake]:
    return ()


@dataclass(frozen=True)
class Convention:
    """One convention.

    Attributes:
        name: as reference.py and findings call it.
        about: what is to be agreed on; of ours the schema of the block says it.
        in_block: its mistakes as other words of the block.
        around: those as changes of what an adapter is shown, and of what it commands.
        in_inputs: those as changes of what its `encode` makes.
        kinds: by kind of such a change, what carries it out.
        steps: by word, the steps of an image's geometry.
        images: by key of an image input, what it does to bytes (..., H, W, 3), after the steps.
        texts: by key of the instruction, what it does to the text, before the template.
        parts: by word, the parts of a vector.
        keys: the block's keys that say it, by where they stand: images, steps, history, normalize, vectors, a kind of
            part, or block for those of the block itself; `*` for all that stand there.
        applies: tells whether it is to be agreed on for a block; by default where one of its keys stands.
        schema: what it adds to the schema of the block: by definition, the properties.
        told_by: what tells it in a data set: a function of `xpl_cli.data.probe.sample.Sample` that yields answers.
    """

    name: str
    about: str = ""
    in_block: Finds = _none
    around: Finds = _none
    in_inputs: Finds = _none
    kinds: Mapping[str, Change] = field(default_factory=dict)
    steps: Mapping[str, Step] = field(default_factory=dict)
    images: Mapping[str, Stage] = field(default_factory=dict)
    texts: Mapping[str, Stage] = field(default_factory=dict)
    parts: Mapping[str, type[Part]] = field(default_factory=dict)
    keys: Mapping[str, Sequence[str]] = field(default_factory=dict)
    applies: Callable[[Entry], bool] | None = None
    schema: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    told_by: Callable[[Any], Iterable[Any]] | None = None


@cache
def ours() -> tuple[Convention, ...]:
    """Return the conventions of this package, by name."""
    folder = importlib.import_module("xpl.conventions")
    found = (importlib.import_module(f"xpl.conventions.{one.name}") for one in pkgutil.iter_modules(folder.__path__))
    return tuple(module.CONVENTION for module in found)


@cache
def others() -> tuple[Convention, ...]:
    """Return those of installed packages.

    Raises:
        EntryPointError: one cannot be imported, or is none.
    """
    found = []
    for entry in registry.entries(registry.CONVENTIONS).values():
        one = getattr(entry.load(), "CONVENTION", None)
        if not isinstance(one, Convention):
            raise entry.broken("it has no CONVENTION, an object of xpl.catalogue.Convention")
        found.append(one)
    return tuple(found)


def conventions() -> tuple[Convention, ...]:
    """Return all conventions: ours, then those of installed packages."""
    return (*ours(), *others())


def found(kind: str, word: str) -> Any:
    """Return what a word means by the conventions that have it under `kind`: ours first; None if none has.

    Args:
        kind: an attribute of `Convention` that is a map: steps, images, texts, parts, kinds.
        word: a key of it.
    """
    for several in (ours, others):  # installed packages are only looked for where we have none
        for one in several():
            if word in getattr(one, kind):
                return getattr(one, kind)[word]
    return None


def applying(block: Entry) -> list[str]:
    """Return the conventions that are to be agreed on for a block, sorted."""
    there = set(_places(block, ()))
    return sorted(one.name for one in conventions() if (one.applies(block) if one.applies else _stands(one, there)))


def of_key(path: Sequence[str | int]) -> str | None:
    """Return the convention that the value at a path of the block is of; None if it is of none."""
    group, key = _place([word for word in path if isinstance(word, str)])
    by_place = _by_place()
    return by_place.get((group, key)) or by_place.get((group, "*"))


def _place(words: Sequence[str]) -> tuple[str, str]:
    """Return where a key stands, and the key, of the words that lead to it."""
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
def _by_place() -> Mapping[tuple[str, str], str]:
    return {(group, key): one.name for one in conventions() for group, keys in one.keys.items() for key in keys}


def _places(value: Any, path: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield where the keys of a block stand."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield _place((*path, key))
            yield from _places(item, (*path, key))
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _places(item, path)


def _stands(one: Convention, there: set[tuple[str, str]]) -> bool:
    return any((group, key) in there for group, keys in one.keys.items() for key in keys)


def kinds(block: Entry) -> set[str]:
    """Return the kinds of the parts that a block has."""
    vectors = [*_list(block.get("state")), block.get("action") or {}]
    return {kind for vector in vectors for part in _list(vector.get("parts")) for kind in part}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def in_block(case: Case) -> Iterator[Mistake]:
    """Yield the mistakes as other words of the block, the likeliest first; whether they fit is not looked at."""
    made = [mistake for one in conventions() for mistake in one.in_block(case)]
    yield from sorted(made, key=lambda one: one.rank)


def around(case: Case) -> Iterator[Mistake]:
    """Yield the mistakes as changes around an adapter, the likeliest first; those that cost no play before others."""
    made = [mistake for one in conventions() for mistake in one.around(case)]
    yield from sorted(made, key=lambda one: (one.rank, one.shown is not None, one.windowed))


def in_inputs(case: Case) -> Iterator[Mistake]:
    """Yield the mistakes as changes of encoded inputs, the likeliest first; those that make pictures again last."""
    made = [mistake for one in conventions() for mistake in one.in_inputs(case)]
    yield from sorted(made, key=lambda one: (one.rank, bool(one.geometry)))
