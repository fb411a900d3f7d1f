"""What a model does to the observations that it is shown, and with a reset that fails; for audits, in its own process.

A client cannot see either: what it sent has long left its memory, and a swallowed failure looks like success.
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
from xpl.nested import Place, leaves, written
from xpl.worker.copies import own

CHANGED, SHARED, SWALLOWED = "changed", "shared", "swallowed"
"""Kinds of notes."""
NOTES, BREAK_RESET = "watched_notes", "watched_break_reset"
"""Operations that a watched model offers besides its own."""
_SHOWING = (spec.Method.UPDATE_OBS, spec.Method.UPDATE_OBS_BATCH, spec.Method.INFER)
_WATCHED = (*_SHOWING, spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH)
_REMEMBERED = 8
"""Observations that are looked at after every operation: the newest ones, which a model may still read."""
_PARTS = (spec.Method.RESET, "clear")


class Watched:
    """A model whose dealings with its observations are noted. Everything else is the model's own.

    Args:
        model: an adapter's model. What it is shown must be nobody else's, and may be written to: a change is to be
            seen, not prevented, as read-only arrays would.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._notes: list[dict[str, str]] = []
        self._seen: deque[_Seen] = deque(maxlen=_REMEMBERED)
        self._last: tuple[str, Any] | None = None

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._model, name)
        return functools.partial(self._watch, name, found) if name in _WATCHED and callable(found) else found

    def watched_notes(self) -> list[dict[str, str]]:
        """Return what was noted so far: `what` (a kind), `method` and `key`, and for shared memory `with`."""
        return list(self._notes)

    def watched_break_reset(self) -> list[str]:
        """Reset once for every part of the model that can be reset, with that part failing; the model is reset then.

        Returns:
            the parts that failed during such a reset; a note tells of each whose failure the reset swallowed.
        """
        tried = []
        for label, owner, name in _parts(self._model):
            if self._last is not None:  # where nothing was shown there may be nothing to reset
                method, argument = self._last
                getattr(self._model, method)(own(argument))
            with _broken(owner, name) as calls:
                try:
                    self._model.reset()
                except (Exception, SystemExit):  # noqa: BLE001 - any is as loud as another
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
            self._last = (name, own(arguments[0]))
            shown = arguments[0] if isinstance(arguments[0], list) else [arguments[0]]
            self._seen.extend(map(_Seen, shown))
        try:
            result = operation(*arguments)
        finally:
            for seen in self._seen:
                for changed in seen.changes():
                    self._note(CHANGED, name, changed)
        for key, array in _arrays(result):
            for seen in self._seen:
                shared = seen.sharing(array)
                if shared is not None:
                    self._note(SHARED, name, written(key), **{"with": shared})
        return result

    def _note(self, what: str, method: str, key: str, **more: str) -> None:
        note = {"what": what, "method": method, "key": key, **more}
        if note not in self._notes:
            self._notes.append(note)


class _Seen:
    """An observation as the model has it, and what it held when it was shown."""

    def __init__(self, obs: object) -> None:
        self._obs = obs
        self._held = _prints(obs)

    def changes(self) -> list[str]:
        """Return the keys that hold something else than at the last look."""
        now = _prints(self._obs)
        changed = [key for key in {**self._held, **now} if self._held.get(key) != now.get(key)]
        self._held = now
        return sorted(map(written, changed))

    def sharing(self, array: np.ndarray) -> str | None:
        """Return the key of an array here that shares memory with another array."""
        for key, held in _arrays(self._obs):
            if np.may_share_memory(held, array) and np.shares_memory(held, array):
                return written(key)
        return None


def _parts(model: Any) -> Iterator[tuple[str, Any, str]]:
    """Yield what a reset may call: methods of the model and of its attributes, with a name for people."""
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
def _broken(owner: object, name: str) -> Iterator[list[str]]:
    """Have a method of one object raise for the length of a `with` block; yields a list of its calls."""
    calls: list[str] = []

    def fail(*_: Any, **__: Any) -> None:
        calls.append(name)
        raise RuntimeError(f"{name} fails: the audit looks whether reset says so")

    had, before = name in vars(owner), vars(owner).get(name)
    try:
        setattr(owner, name, fail)
    except Exception:  # noqa: BLE001 - it cannot be replaced, so it cannot be tried
        yield calls
        return
    try:
        yield calls
    finally:
        if had:
            setattr(owner, name, before)
        else:
            delattr(owner, name)


def _arrays(value: object) -> Iterator[tuple[Place, np.ndarray]]:
    """Yield every array in a value, and the memory of every tensor that lies where an array can see it."""
    for key, leaf in leaves(value):
        if isinstance(leaf, np.ndarray):
            yield key, leaf
        elif hasattr(leaf, "detach"):
            with contextlib.suppress(Exception):  # of a type that numpy has not, or elsewhere than in memory
                yield key, leaf.detach().numpy()


def _prints(obs: object) -> dict[Place, str]:
    """Return a short text for every value of an observation, equal as long as the value is."""
    return {
        key: f"{leaf.dtype.str}{leaf.shape}{hashlib.sha256(leaf.tobytes()).hexdigest()}"
        if isinstance(leaf, np.ndarray)
        else repr(leaf)
        for key, leaf in leaves(obs)
    }
