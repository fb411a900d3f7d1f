"""Linear fit of actions to the golden ones: finds a scale or an offset that no listed mistake has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl_cli.model_io.difference import Answers, EpisodeAnswers, columns
from xpl_cli.model_io.explain import TriedChange

if TYPE_CHECKING:
    from xpl.contract import State
    from xpl_cli.model_io.difference import Differences

_FALLS = 20.0
"""By how much the difference of each number has to fall."""
_LEAST = 12
"""Numbers that a line is drawn through at least."""
_BETTER = 10.0
"""By how much a later kind of line has to leave less than an earlier one."""
_NEAR = 1e-3
_NONE = 1e-6
"""Offsets below are rounding."""
_STILL = 1e-9
_RIGHT_ANGLE = np.pi / 2


@dataclass(frozen=True)
class _LinearFit:
    """A line from the adapter's numbers to the golden ones.

    Attributes:
        rest: what remains, as a share of the span.
        slope, constant: of the line.
        words: of the line.
        is_referred: whether the two are counted from different states.
    """

    rest: float
    slope: float
    constant: float
    words: str
    is_referred: bool


@dataclass(frozen=True)
class AnswerRows:
    """All steps of all answers by key, (N, width): golden, the adapter's, and the state at the question."""

    golden: Mapping[str, np.ndarray]
    adapter: Mapping[str, np.ndarray]
    states: Mapping[str, np.ndarray]

    @classmethod
    def of(cls, episodes: Sequence[EpisodeAnswers]) -> AnswerRows | None:
        """Return the steps of episodes; None if chunks are of other lengths."""
        golden = [chunk for episode in episodes for chunk in episode.golden]
        answers = [chunk for episode in episodes for chunk in episode.adapter]
        if any(len(one) != len(other) for one, other in zip(golden, answers, strict=True)):
            return None
        states = [episode.observations[index][spec.Obs.STATE] for episode in episodes for index in episode.asked_at]
        return cls(columns(golden), columns(answers), _repeat_states(answers, states))


def fit_linear(
    episodes: Sequence[EpisodeAnswers], before: Differences, spread: Mapping[str, float], tolerance: float
) -> TriedChange | None:
    """Return the change by which each number that differs is a straight line of the golden one, or None.

    Args:
        episodes: all episodes.
        before: how far the answers are, by number.
        spread: of `difference.spreads`.
        tolerance: largest share that is no difference.
    """
    rows = AnswerRows.of(episodes)
    if rows is None:
        return None
    remaining, lines = dict(before), dict[str, _LinearFit]()
    for part in (part for part, value in before.items() if value > tolerance):
        line = _fit_line(rows, part, spread[part])
        if line is None or line.rest > tolerance or line.rest * _FALLS > before[part]:
            return None
        remaining[part] = line.rest
        lines[part] = line
    return TriedChange(_summary(lines), _convention(lines), remaining) if lines else None


def _repeat_states(answers: Answers, states: Sequence[State]) -> dict[str, np.ndarray]:
    rows: dict[str, list[np.ndarray]] = {}
    for steps, state in zip(answers, states, strict=True):
        for step in steps:
            for key in step:
                rows.setdefault(key, []).append(np.asarray(state[key], np.float64))
    return {key: np.stack(values) for key, values in rows.items()}


def _fit_line(rows: AnswerRows, part: str, spread: float) -> _LinearFit | None:
    """Return the line golden = slope * adapter + constant, of values or of changes, that leaves least, or None."""
    key, rest = part.rstrip("]").split("[")
    index = int(rest)
    if key not in rows.adapter or (key.endswith(spec.State.EE_POSE) and index >= spec.POSITION_DIM):
        return None
    golden, adapter, start = (by_key[key][:, index] for by_key in (rows.golden, rows.adapter, rows.states))
    inside = np.ones(len(adapter), bool)
    if key.endswith(spec.State.EE_JOINT_STATE):  # what is quite closed or open may have been clipped
        inside = (adapter > spec.GRIPPER_CLOSED) & (adapter < spec.GRIPPER_OPEN)
        inside &= (golden > spec.GRIPPER_CLOSED) & (golden < spec.GRIPPER_OPEN)
    if inside.sum() < max(_LEAST, len(adapter) // 16):
        return None
    still = np.zeros_like(start)
    bases = [
        ("answer", still, still),
        ("change of the state", start, start),
        ("answer, and the state", still, start),
        ("answer less the state", start, still),
        *((f"change of {other}", by_key[:, index], start) for other, by_key in _same_field_of_others(rows.states, key)),
    ]
    best: _LinearFit | None = None
    for words, of, to in bases:
        x, y = (adapter - of)[inside], (golden - to)[inside]
        if np.ptp(x) <= _STILL:
            continue
        slope, constant = np.polyfit(x, y, 1)
        left = float(np.abs(slope * x + constant - y).max()) / spread
        if best is None or left * _BETTER < best.rest:
            formula = f"golden = {slope:.4g} * {words}" + (f" {constant:+.3g}" if abs(constant) > _NONE else "")
            best = _LinearFit(left, float(slope), float(constant), formula, of is not to)
    return best


def _same_field_of_others(states: Mapping[str, np.ndarray], key: str) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the same field of other arms."""
    name = key.partition("_")[2]
    for other, values in states.items():
        if other != key and other.partition("_")[2] == name and values.shape == states[key].shape:
            yield other, values


def _summary(lines: Mapping[str, _LinearFit]) -> str:
    (part, line), *others = lines.items()
    return f"{part}: {line.words}" + (f" (and {len(others)} more numbers)" if others else "")


def _convention(lines: Mapping[str, _LinearFit]) -> str:
    """Return what a line is about.

    What is counted from another state is a reference; grippers have their own; a factor of 57.3 is degrees; signs and
    zeros that are right angles away are of the joints; other scales and offsets normalise.
    """
    fits = list(lines.values())
    if any(line.is_referred for line in fits):
        return "action_reference"
    if all(key.partition("[")[0].endswith(spec.State.EE_JOINT_STATE) for key in lines):
        return "gripper"
    factors = (np.rad2deg(1.0), np.deg2rad(1.0))
    if all(min(abs(abs(line.slope) / factor - 1.0) for factor in factors) < _NEAR for line in fits):
        return "angle_unit"
    if any(abs(abs(line.slope) - 1.0) >= _NEAR for line in fits):
        return "normalization"
    offsets = [line.constant for line in fits if abs(line.constant) > _NONE]
    zeros = all(abs(one / _RIGHT_ANGLE - round(one / _RIGHT_ANGLE)) < _NEAR for one in offsets)
    return "joint_order" if zeros else "normalization"
