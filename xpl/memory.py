"""Recurrent state of one environment in one episode, which advances once per observation.

The policy may run inference twice on one observation, or never, and an inference may fail and be repeated. The state
depends on none of that: it is a function of the observations with an inference, in order.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_NOTHING = object()


class MemoryUseError(RuntimeError):
    """A memory was used outside of an inference."""


class Memory:
    """State of one environment, for use in `predict` and `decode`.

    `Policy` calls `begin` before each inference and `commit` after it.
    """

    def __init__(self) -> None:
        self._before: Any = None
        self._after: Any = None
        self._settled = -1
        self._skipped = 0
        self._step: int | None = None
        self._staged: Any = _NOTHING

    # -- for adapters --------------------------------------------------------------------------------------------------

    @property
    def value(self) -> Any:
        """The value kept at the last observation with an inference before this one; None at the first of an episode.

        A repeated inference on one observation reads the same value. Arrays are read-only.
        """
        return self._before if self._current_step() == self._settled else self._after

    @property
    def skipped(self) -> int:
        """Number of observations without an inference since the last one with an inference."""
        now = self._current_step()
        return self._skipped if now == self._settled else now - self._settled - 1

    def keep(self, value: Any) -> None:
        """Keep a value for the next observation; of two inferences on one observation the first counts.

        Args:
            value: any value; arrays in it, also inside maps and lists, are copied. Tensors are not: create new
                ones, and change none in place.
        """
        self._current_step()
        self._staged = _read_only_copy(value)

    # -- for the base class --------------------------------------------------------------------------------------------

    def begin(self, step: int) -> None:
        """Begin an inference on observation number `step` of the episode, from 0."""
        self._step, self._staged = step, _NOTHING

    def commit(self, *, answered: bool) -> None:
        """End the inference; the kept value counts if it succeeded and was the first on its observation.

        Args:
            answered: whether the inference succeeded.
        """
        step, staged = self._step, self._staged
        self._step, self._staged = None, _NOTHING
        if step is None or not answered or step == self._settled:
            return
        self._skipped = step - self._settled - 1
        self._before, self._settled = self._after, step
        if staged is not _NOTHING:
            self._after = staged

    def _current_step(self) -> int:
        if self._step is None:
            raise MemoryUseError("a memory is for predict and decode: no inference is running")
        return self._step


def _read_only_copy(value: Any) -> Any:
    """Return a value with its arrays copied and read-only."""
    if isinstance(value, np.ndarray):
        copied = value.copy()
        copied.flags.writeable = False
        return copied
    if isinstance(value, dict):
        return {key: _read_only_copy(item) for key, item in value.items()}
    if type(value) in (list, tuple):
        return type(value)(_read_only_copy(item) for item in value)
    return value
