"""How well a hypothesis on commands explains the robot's next step.

A robot follows its command: each step covers part of the distance from the state to the commanded target. So for a
correct hypothesis C on the commands, the differences C[t-i] - S[t] explain the next step S[t+1] - S[t] with
non-negative gains; for a wrong one they do not. The error is the unexplained
share of the squared steps; an uninformative command has error 1.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import rotation

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Minus = Callable[[np.ndarray, np.ndarray], np.ndarray]

SHIFTS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, -1, -2, -3)
"""Steps by which a command may take effect late, or (negative) be recorded late."""
PLAIN: Final = 0.3
"""Errors up to which a hypothesis explains the motion."""
_SCALES: Final = tuple(float(scale) for scale in 2.0 ** np.arange(-10, 10.1, 0.25))
_SHARP: Final = (0.8, 1.25)
_LAGS: Final = 3
_LONGEST: Final = 15
"""Most steps until a command is reached."""


def numbers(there: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return the difference of two vectors."""
    difference: np.ndarray = there - here
    return difference


def turns(there: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return the rotation from `here` to `there` (..., 4) as a rotation vector (..., 3) in the fixed frame."""
    return rotation.to_axis_angle(rotation.multiply(there, rotation.conjugate(here)))


@dataclass(frozen=True)
class Follow:
    """How a state follows its commands.

    Attributes:
        error: unexplained share of the motion.
        shift: steps by which commands take effect late; negative where they are recorded late.
        gain: share of the distance to its command that it covers in a step.
    """

    error: float
    shift: int
    gain: float = 0.0


def follow(
    states: Sequence[np.ndarray], commands: Sequence[np.ndarray], minus: Minus = numbers, shifts: Sequence[int] = (0,)
) -> Follow:
    """Return how states follow commands.

    Args:
        states: by episode, (T, D).
        commands: likewise, of the same unit and frame.
        minus: the difference of two of them.
        shifts: steps by which commands may take effect late.
    """
    candidates = [_follow_at_shift(states, commands, minus, shift) for shift in shifts]
    least = min(one.error for one in candidates)
    return next(one for one in candidates if one.error <= 1.02 * least + 1e-9)


def tracking_delay(states: Sequence[np.ndarray], commands: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return after how many steps commands are reached, and the remaining error, a share of the motion.

    Both are means: the first is the minimum of a parabola through the least error and its neighbours.
    """
    errors = []
    longest = min(_LONGEST, min(len(rows) for rows in states) // 2)
    for lag in range(longest):
        off = [c[: len(c) - lag] - s[lag:] for s, c in zip(states, commands, strict=True)]
        errors.append(float(np.mean(np.concatenate(off) ** 2)))
    about = [rows - rows[len(rows) // 2] for rows in states]
    span = float(np.mean(np.concatenate(about) ** 2)) or 1.0
    best = int(np.argmin(errors))
    share = float(np.sqrt(errors[best] / span))
    if not 0 < best < longest - 1:
        return float(best), share
    before, here, after = errors[best - 1 : best + 2]
    bend = before - 2 * here + after
    return best + (0.5 * (before - after) / bend if bend > 0 else 0.0), share


def cumulated(states: Sequence[np.ndarray], steps: Sequence[np.ndarray], scale: float = 1.0) -> list[np.ndarray]:
    """Return commands (T, D) that start at the state and add one delta per step."""
    return [here[:1] + scale * np.cumsum(step, axis=0) for here, step in zip(states, steps, strict=True)]


def sharpness(states: Sequence[np.ndarray], steps: Sequence[np.ndarray], shift: int, scale: float = 1.0) -> float:
    """Return how much better summed deltas explain the motion than the same deltas scaled by 0.8 or 1.25.

    Deltas to the state explain the motion at any scale, as gains are free. Summed over an episode they follow the state
    at one scale only.
    """
    own = _follow_at_shift(states, cumulated(states, steps, scale), numbers, shift).error
    others = [
        follow(states, cumulated(states, steps, scale * other), numbers, (shift, shift + 1)).error for other in _SHARP
    ]
    return min(others) / max(own, 1e-6)


def scaled(states: Sequence[np.ndarray], steps: Sequence[np.ndarray]) -> tuple[float, Follow]:
    """Return the scale at which summed deltas explain one number (T, 1) best, and the fit."""
    tried = [(scale, follow(states, cumulated(states, steps, scale), numbers, (0, 1))) for scale in _SCALES]
    about, _ = min(tried, key=lambda entry: entry[1].error)
    near = [about * factor for factor in np.linspace(0.86, 1.16, 31)]
    tried = [(scale, follow(states, cumulated(states, steps, scale), numbers, (0, 1))) for scale in near]
    return min(tried, key=lambda entry: entry[1].error)


def _follow_at_shift(states: Sequence[np.ndarray], commands: Sequence[np.ndarray], minus: Minus, shift: int) -> Follow:
    """Return error and gain of commands at one shift."""
    begin, late = max(shift + _LAGS - 1, _LAGS - 1), max(-shift, 0)
    gram, moment, power = np.zeros((_LAGS, _LAGS)), np.zeros(_LAGS), 0.0
    for state, command in zip(states, commands, strict=True):
        last = len(state) - 1 - late
        if last - begin < 2:
            continue
        here, after = state[begin:last], state[begin + 1 : last + 1]
        step = minus(after, here)
        reasons = [minus(command[begin - shift - lag : last - shift - lag], here) for lag in range(_LAGS)]
        columns = np.stack([reason.ravel() for reason in reasons])
        gram += columns @ columns.T
        moment += columns @ step.ravel()
        power += float((step * step).sum())
    if power <= 0:
        return Follow(1.0, shift)
    left, gain = _unexplained_share(gram, moment, power)
    return Follow(left, shift, gain)


def _unexplained_share(gram: np.ndarray, moment: np.ndarray, power: float) -> tuple[float, float]:
    """Return the unexplained share with the best non-negative gains, and their sum; all subsets of lags are tried."""
    best, gain = power, 0.0
    size = len(moment)
    ridge = 1e-9 * float(np.trace(gram)) / size + 1e-300
    for count in range(1, size + 1):
        for lags in itertools.combinations(range(size), count):
            part = gram[np.ix_(lags, lags)] + ridge * np.eye(count)
            gains = np.linalg.solve(part, moment[list(lags)])
            left = power - float(gains @ moment[list(lags)])
            if (gains >= 0).all() and left < best:
                best, gain = left, float(gains.sum())
    return max(best, 0.0) / power, gain
