"""Chunks at another rate than they are executed at: what their steps would be at the robot's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk
from xpl import rotation
from xpl_cli.model_io.alternatives.signals import Signal

if TYPE_CHECKING:
    from xpl_cli.model_io.alternatives.signals.signal import Given, Step

_TURN = slice(sdk.POSITION_DIM, sdk.POSE_DIM)


def rates() -> Iterator[Signal]:
    """Yield the change to a model whose steps last twice, three times, or half as long as control steps."""
    for rank, words, steps in (
        (0, "rate: half of the control rate", 2.0),
        (0, "rate: twice the control rate", 0.5),
        (2, "rate: a third of the control rate", 3.0),
    ):
        yield Signal(rank, words, "chunk", None, partial(_commanded, steps))


def _commanded(
    lasts: float, answers: Sequence[Sequence[Given]], _seen: Sequence[object], _asked: Sequence[int]
) -> list[list[Step]]:
    return [[_at(chunk, (place + 1) / lasts - 1) for place in range(len(chunk))] for chunk in answers]


def _at(chunk: Sequence[Given], place: float) -> Step:
    """Return the step between two of a chunk; None before the first and after the last one."""
    if not 0 <= place <= len(chunk) - 1:
        return None
    one, other = chunk[int(place)], chunk[min(int(place) + 1, len(chunk) - 1)]
    share = place - int(place)
    return {key: _between(key, np.asarray(one[key]), np.asarray(other[key]), share) for key in one}


def _between(key: str, one: np.ndarray, other: np.ndarray, share: float) -> np.ndarray:
    if key.endswith(sdk.State.EE_POSE) and float(one[_TURN] @ other[_TURN]) < 0:
        other = np.concatenate((other[: sdk.POSITION_DIM], -other[_TURN]))
    mixed = (1 - share) * one + share * other
    if key.endswith(sdk.State.EE_POSE):
        mixed[_TURN] = rotation.normalise(mixed[_TURN])
    return mixed
