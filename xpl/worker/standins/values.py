"""What a thing with data is worth: what a transformation was given, tokens of a text, or a chunk of actions."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.worker.answers import Answers, ShadowError
from xpl.worker.standins import facts as known
from xpl.worker.standins.facts import Facts
from xpl.worker.standins.given import Given, as_data, is_data, is_image
from xpl.worker.standins.origins import holds, origin, refuse
from xpl.worker.standins.things import Thing

_TOKENS = 16
_WIDEST = 64
_FEATURES = 64


class Values:
    """Makes values of things.

    Args:
        facts: sizes of an action.
    """

    def __init__(self, facts: Facts) -> None:
        self._facts = facts
        self._guess = 0
        self._shown: dict[str, set[str]] = {}
        self._encoders: dict[str, Answers] = {}
        self._answers: dict[int, Answers] = {}
        self._made: dict[tuple[int, tuple[Any, ...]], tuple[Given, Any]] = {}

    def guess(self, place: int) -> None:
        """Take the actions of models to be as wide as another place of the adapter's says."""
        self._guess = place
        self._made.clear()

    def of(self, thing: Thing) -> Any:
        """Return the array or tensor that a thing is worth; the same thing is worth the same."""
        told = origin(thing)
        given = told.given
        if given is None:
            refuse(told.name, "value")
        key = (id(given), tuple(map(repr, told.keys)))
        if key not in self._made:
            if len(self._made) > 64:
                self._made.clear()
            self._made[key] = (given, self._of(given, told.keys))
        return self._made[key][1]

    def _of(self, given: Given, keys: tuple[Any, ...]) -> Any:
        name = str(next((key for key in reversed(keys) if isinstance(key, str)), given.verb))
        if known.TRANSFORMS.fullmatch(given.verb.lower()):
            found = given.entry(keys) if keys else None
            if found is None:
                found = _first(given.values)
            if holds(found):
                found = self.of(found)
            if is_image(found):
                return _typed(np.asarray(found).transpose(2, 0, 1).astype(np.float32) / 255.0)
            if found is not None and as_data(found) is not None:
                return found
        worth = self._facts.worth(name) if keys else None
        if isinstance(worth, (int, float)) or (worth is not None and not known.ANSWERS.fullmatch(given.verb)):
            return worth
        if known.TOKENS.fullmatch(name.lower()):
            return self._tokens(given, name)
        if known.EMBEDS.fullmatch(name) or (given.verb == "__call__" and known.EMBEDS.fullmatch(given.owner)):
            return self._features(given, keys)
        return self._actions(given, keys)

    def _tokens(self, given: Given, name: str) -> Any:
        count = given.count
        rows = [_digest(given.shown(row if count else None)) for row in range(count or 1)]
        array = np.stack([np.random.default_rng(seed).integers(2, 30000, _TOKENS) for seed in rows])
        return _typed(np.ones_like(array, bool) if "mask" in name else array)

    def _features(self, given: Given, keys: tuple[Any, ...]) -> Any:
        count = given.count
        label = [str(key) for key in keys]
        low, high = -np.ones(_FEATURES), np.ones(_FEATURES)
        answers = self._encoders.setdefault(given.owner, Answers((_TOKENS, _FEATURES), low, high))
        return _typed(np.stack([answers.of([given.shown(row if count else None), label]) for row in range(count or 1)]))

    def _actions(self, given: Given, keys: tuple[Any, ...]) -> Any:
        width = self._width(given, keys)
        count = given.count
        label = [str(key) for key in keys]
        self._look_for_nothing(given)
        try:
            rows = [self._answer(width).of([given.shown(row if count else None), label]) for row in range(count or 1)]
        except ShadowError:
            refuse(given.verb, "value that could depend on what was shown")
        if width == self._facts.width:
            for start in self._facts.quaternions:
                for row in rows:
                    row[:, start : start + 4] /= np.linalg.norm(row[:, start : start + 4], axis=1, keepdims=True)
        return _typed(np.stack(rows) if count else rows[0])

    def _look_for_nothing(self, given: Given) -> None:
        """Refuse to answer where something is none that was shown before: nobody knows what the real one does then."""
        seen = self._shown.setdefault(given.verb, set())
        for path, item in _entries(given.values, ""):
            if item is None and path in seen:
                refuse(given.verb, f"answer to nothing under {path.strip('/')}")
            if item is not None and not isinstance(item, (bool, int, float)):
                seen.add(path)

    def _answer(self, width: int) -> Answers:
        if width not in self._answers:
            low, high = self._facts.low, self._facts.high
            if width != self._facts.width:
                low, high = np.full(width, low.min()), np.full(width, high.max())
            self._answers[width] = Answers((self._facts.steps, width), low, high)
        return self._answers[width]

    def _width(self, given: Given, keys: tuple[Any, ...]) -> int:
        """Return the width of what was shown under the same name, as of one limb; otherwise that of an action."""
        name = next((key for key in reversed(keys) if isinstance(key, str)), None)
        if name is not None:
            tail = name.replace("/", ".").rpartition(".")[2]
            found = _by_tail(given.values, tail)
            if found is not None and tail not in ("action", spec.Payload.ACTIONS, "state"):
                return found
        return self._facts.widths[self._guess]


def _entries(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _entries(item, f"{path}/{key}")
    elif isinstance(value, (list, tuple)) and len(value) <= _TOKENS:
        for place, item in enumerate(value):
            yield from _entries(item, f"{path}/{place}")
    else:
        yield path, value


def _typed(array: np.ndarray) -> Any:
    """Return a tensor where torch is stood in for, as a model of torch would give."""
    if "torch" in sys.modules and hasattr(sys.modules["torch"], "is_stand_in"):
        from xpl.worker.standins.torch.tensor import Tensor

        return Tensor(array)
    return array


def _digest(shown: Any) -> int:
    return int.from_bytes(hashlib.sha256(_words(shown).encode()).digest()[:8], "little")


def _words(shown: Any) -> str:
    if isinstance(shown, np.ndarray):
        return hashlib.sha256(np.ascontiguousarray(shown).tobytes()).hexdigest()
    if isinstance(shown, Mapping):
        return "{" + ",".join(f"{key}:{_words(value)}" for key, value in sorted(shown.items())) + "}"
    if isinstance(shown, (list, tuple)):
        return "[" + ",".join(map(_words, shown)) + "]"
    return repr(shown)


def _first(value: Any) -> Any:
    """Return the first array, or thing with data, of some arguments."""
    if as_data(value) is not None or holds(value):
        return value
    if isinstance(value, Given):
        return _first(value.values)
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        if value and all(isinstance(item, (int, float)) for item in value):
            return None
        for item in value:
            found = _first(item)
            if found is not None:
                return found
    return None


def _by_tail(value: Any, tail: str) -> int | None:
    if isinstance(value, Mapping):
        for key, item in value.items():
            array = as_data(item)
            is_named = str(key).replace("/", ".").rpartition(".")[2] == tail
            if is_named and array is not None and array.ndim and array.shape[-1] <= _WIDEST:
                return int(array.shape[-1])
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        for item in value:
            found = _by_tail(item, tail)
            if found is not None:
                return found
    if isinstance(value, Thing) and holds(value):
        given = origin(value).given
        return None if given is None else _by_tail(given.values, tail)
    is_holder = hasattr(value, "__dict__") and not isinstance(value, (type, Thing, np.ndarray))
    if is_holder and not hasattr(value, "is_noise") and is_data(list(vars(value).values()), texts=False):
        return _by_tail(vars(value), tail)
    return None
