"""What a recurrent policy keeps of one environment in one episode: it advances once for each observation, never twice.

An observation may be asked about twice, or never; a question may fail and be put again. What was kept depends on none
of that: it is a function of the observations that were asked about, in their order.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_NOTHING = object()


class MemoryUseError(RuntimeError):
    """A memory was used where no question is being answered."""


class Memory:
    """State of one environment: read and kept in `predict` and `decode`, while a question is answered.

    `Policy` opens it for each question, and settles it when the question was answered.
    """

    def __init__(self) -> None:
        self._before: Any = None
        self._after: Any = None
        self._settled = -1
        self._skipped = 0
        self._asked: int | None = None
        self._staged: Any = _NOTHING

    # -- for adapters --------------------------------------------------------------------------------------------------

    @property
    def value(self) -> Any:
        """What was kept at the observation that was asked about before this one; None at the first of an episode.

        Who asks about the same observation again sees the same value. Arrays are read-only.
        """
        return self._before if self._now() == self._settled else self._after

    @property
    def skipped(self) -> int:
        """Number of observations, since the one that was asked about before, that nobody asked about."""
        now = self._now()
        return self._skipped if now == self._settled else now - self._settled - 1

    def keep(self, value: Any) -> None:
        """Keep a value for the next observation. Of two answers about one observation the first counts.

        Args:
            value: anything; arrays in it, also inside maps and lists, are copied. Tensors are not: make new
                ones, and change none in place.
        """
        self._now()
        self._staged = _own(value)

    # -- for the base class --------------------------------------------------------------------------------------------

    def ask(self, step: int) -> None:
        """Open the memory for a question about observation number `step`."""
        self._asked, self._staged = step, _NOTHING

    def settle(self, *, answered: bool) -> None:
        """Close the memory. What was kept stays if this was the first answer about its observation."""
        step, staged = self._asked, self._staged
        self._asked, self._staged = None, _NOTHING
        if step is None or not answered or step == self._settled:
            return
        self._skipped = step - self._settled - 1
        self._before, self._settled = self._after, step
        if staged is not _NOTHING:
            self._after = staged

    def _now(self) -> int:
        if self._asked is None:
            raise MemoryUseError("a memory is for predict and decode: no question is being answered now")
        return self._asked


def _own(value: Any) -> Any:
    """Return a value whose arrays are copies that cannot be changed."""
    if isinstance(value, np.ndarray):
        copied = value.copy()
        copied.flags.writeable = False
        return copied
    if isinstance(value, dict):
        return {key: _own(item) for key, item in value.items()}
    if type(value) in (list, tuple):
        return type(value)(_own(item) for item in value)
    return value
