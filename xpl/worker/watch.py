"""Records what a model does to its observations, and whether reset hides a failure; for audits, in its process.

A client can detect neither: it has only copies, and a suppressed exception looks like success.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
from collections import deque
from collections.abc import Iterator
from types import ModuleType
from typing import Any, Callable

import numpy as np

from xpl import _spec as spec
from xpl.nested import ValuePath, format_path, leaves
from xpl.worker import generators
from xpl.worker.copies import copy_value

CHANGED, SHARED, SWALLOWED, DREW = "changed", "shared", "swallowed", "drew"
"""Kinds of notes."""
NOTES, BREAK_RESET = "watched_notes", "watched_break_reset"
"""Additional operations of a watched model."""
_SHOWING = (spec.Method.UPDATE_OBS, spec.Method.UPDATE_OBS_BATCH, spec.Method.INFER)
_WATCHED = (*_SHOWING, spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH)
_ACTING = (spec.Method.INFER, spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH)
_REMEMBERED = 8
"""Number of the newest observations that are checked after every operation: a model may still read them."""
_PARTS = (spec.Method.RESET, "clear")


class WatchedModel:
    """Wrapper of a model that records what the model does to its observations.

    Args:
        model: an adapter's model. Its observations must be separate, writable arrays: read-only ones would prevent the
            changes that are recorded here.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._notes: list[dict[str, str]] = []
        self._watched: deque[_WatchedObservation] = deque(maxlen=_REMEMBERED)
        self._last: tuple[str, Any] | None = None

    def __getattr__(self, name: str) -> Any:
        attribute = getattr(self._model, name)
        return (
            functools.partial(self._watch, name, attribute) if name in _WATCHED and callable(attribute) else attribute
        )

    def watched_notes(self) -> list[dict[str, str]]:
        """Return the notes so far: `what` (a kind), `method` and `key`, and for shared memory `with`."""
        return list(self._notes)

    def watched_break_reset(self) -> list[str]:
        """Reset once for every part of the model that has a reset, with that part failing; then reset the model.

        Returns:
            the parts that failed during such a reset; a note names each whose failure the reset suppressed.
        """
        tried = []
        for label, owner, name in _parts(self._model):
            if self._last is not None:  # without an observation there may be nothing to reset
                method, argument = self._last
                getattr(self._model, method)(copy_value(argument))
            with _failing_method(owner, name) as calls:
                try:
                    self._model.reset()
                except (Exception, SystemExit):  # noqa: BLE001 - any exception reports the failure
                    swallowed = False
                else:
                    swallowed = True
            if calls:
                tried.append(label)
                if swallowed:
                    self._note(SWALLOWED, spec.Method.RESET, label)
        self._model.reset()
        return tried

    def _watch(self, name: str, operation: Callable[..., Any], *arguments: Any) -> Any:
        if name in _SHOWING:
            self._last = (name, copy_value(arguments[0]))
            observations = arguments[0] if isinstance(arguments[0], list) else [arguments[0]]
            self._watched.extend(map(_WatchedObservation, observations))
        before = generators.fingerprints()
        try:
            result = operation(*arguments)
        finally:
            for generator, state in generators.fingerprints().items() if name in _ACTING else ():
                if before.get(generator, state) != state:
                    self._note(DREW, name, generator)
            for seen in self._watched:
                for changed in seen.changes():
                    self._note(CHANGED, name, changed)
        for key, array in _arrays(result):
            for seen in self._watched:
                shared = seen.sharing(array)
                if shared is not None:
                    self._note(SHARED, name, format_path(key), **{"with": shared})
        return result

    def _note(self, what: str, method: str, key: str, **more: str) -> None:
        note = {"what": what, "method": method, "key": key, **more}
        if note not in self._notes:
            self._notes.append(note)


class _WatchedObservation:
    """An observation that the model has, and fingerprints of its values."""

    def __init__(self, obs: object) -> None:
        self._obs = obs
        self._fingerprints = _fingerprints(obs)

    def changes(self) -> list[str]:
        """Return the keys whose values changed since the last call."""
        now = _fingerprints(self._obs)
        changed = [key for key in {**self._fingerprints, **now} if self._fingerprints.get(key) != now.get(key)]
        self._fingerprints = now
        return sorted(map(format_path, changed))

    def sharing(self, array: np.ndarray) -> str | None:
        """Return the key of an array here that shares memory with another array."""
        for key, held in _arrays(self._obs):
            if np.may_share_memory(held, array) and np.shares_memory(held, array):
                return format_path(key)
        return None


def _parts(model: Any) -> Iterator[tuple[str, Any, str]]:
    """Yield (label, owner, name) of methods that a reset may call, of the model and its attributes."""
    for name in _resets(model):
        if name != spec.Method.RESET:
            yield name, model, name
    for attribute, value in list(vars(model).items()):
        if hasattr(value, "__dict__") and not isinstance(value, (type, ModuleType)):
            yield from ((f"{attribute}.{name}", value, name) for name in _resets(value))


def _resets(value: object) -> list[str]:
    return [
        name
        for name in dir(value)
        if name.lstrip("_").startswith(_PARTS) and callable(inspect.getattr_static(value, name, None))
    ]


@contextlib.contextmanager
def _failing_method(owner: object, name: str) -> Iterator[list[str]]:
    """Let a method of an object raise within a `with` block; yield the list of its calls."""
    calls: list[str] = []

    def fail(*_: Any, **__: Any) -> None:
        calls.append(name)
        raise RuntimeError(f"{name} fails: the audit checks whether reset reports it")

    had, before = name in vars(owner), vars(owner).get(name)
    try:
        setattr(owner, name, fail)
    except Exception:  # noqa: BLE001 - a method that cannot be replaced cannot be tested
        yield calls
        return
    try:
        yield calls
    finally:
        if had:
            setattr(owner, name, before)
        else:
            delattr(owner, name)


def _arrays(value: object) -> Iterator[tuple[ValuePath, np.ndarray]]:
    """Yield (path, array) of every array in a value, and of every tensor that numpy can view."""
    for key, leaf in leaves(value):
        if isinstance(leaf, np.ndarray):
            yield key, leaf
        elif hasattr(leaf, "detach"):
            with contextlib.suppress(Exception):  # a type that numpy lacks, or a tensor on another device
                yield key, leaf.detach().numpy()


def _fingerprints(obs: object) -> dict[ValuePath, str]:
    """Return a fingerprint of every value of an observation, by path."""
    return {
        key: f"{leaf.dtype.str}{leaf.shape}{hashlib.sha256(leaf.tobytes()).hexdigest()}"
        if isinstance(leaf, np.ndarray)
        else repr(leaf)
        for key, leaf in leaves(obs)
    }
