"""Calls that advance a model's state twice by one observation; the second one is left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any, Callable

import numpy as np

_OURS = ("builtins", "numpy", "xpl")
_MOST = 64
"""Most methods that are wrapped."""


class StepOncePerObservation:
    """Returns the previous result for a repeated call of a method of the model's attributes.

    A repeated call has the arguments of the previous one, except those that it returned: the advanced state.
    """

    def __init__(self) -> None:
        self.left_out = 0
        self._last: dict[str, tuple[Sequence[Any], Mapping[str, Any], Any]] = {}

    @contextmanager
    def around(self, model: Any) -> Iterator[None]:
        """Wrap the public methods of a model's attributes within a `with` block."""
        watched = list(_methods(model))[:_MOST]
        for place, name in watched:
            setattr(place, name, self._watched(f"{id(place)} {name}", getattr(place, name)))
        try:
            yield
        finally:
            for place, name in watched:
                delattr(place, name)

    def _watched(self, key: str, method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def called(*arguments: Any, **named: Any) -> Any:
            before = self._last.get(key)
            if before is not None and _is_again(before, arguments, named):
                self.left_out += 1
                return before[2]
            result = method(*arguments, **named)
            self._last[key] = arguments, named, result
            return result

        return called


def _methods(model: Any) -> Iterator[tuple[Any, str]]:
    """Yield the attributes of a model, and the names of their public methods that can be replaced."""
    for held in list(vars(model).values()):
        if type(held).__module__.partition(".")[0] in _OURS or not hasattr(held, "__dict__"):
            continue
        for name in dir(type(held)):
            is_method = callable(getattr(type(held), name, None)) and name not in vars(held)
            if not name.startswith("_") and is_method and name not in ("train", "eval", "to", "parameters", "modules"):
                yield held, name


def _is_again(before: tuple[Sequence[Any], Mapping[str, Any], Any], arguments: Sequence[Any], named: Any) -> bool:
    were, were_named, result = before
    if len(were) != len(arguments) or set(were_named) != set(named):
        return False
    returned = list(result) if isinstance(result, (tuple, list)) else [result]
    pairs = [*zip(were, arguments), *((were_named[key], named[key]) for key in named)]
    equal = [_equal(one, other) for one, other in pairs]
    # An argument that is neither equal nor the previous result makes it another call.
    return any(equal) and all(same or any(other is one for one in returned) for same, (_, other) in zip(equal, pairs))


def _equal(one: Any, other: Any) -> bool:
    if one is other:
        return True
    try:
        return bool(np.array_equal(np.asarray(one), np.asarray(other)))
    except (TypeError, ValueError, RuntimeError):
        return False
