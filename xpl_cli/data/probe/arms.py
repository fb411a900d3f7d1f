"""The reference and form of an arm's commands: hypotheses, and how well each explains the arm's motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import rotation
from xpl.conventions import rotation as rotations
from xpl.convert import ConversionError
from xpl_cli.data.probe import tracking
from xpl_cli.data.probe.answer import HypothesisRanking
from xpl_cli.data.probe.tracking import SHIFTS, Follow

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    Rows = Sequence[np.ndarray]

ABSOLUTE, DELTA_STATE, DELTA_COMMAND = "absolute", "delta_state", "delta_command"
FIXED, BODY, NUMBERS = "fixed", "body", "numbers"
EULER: Final = tuple(
    (one, other)
    for axes in ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
    for one, other in (("euler", axes), ("euler", axes.upper()))
)
FORMS: Final[Mapping[int, tuple[tuple[str, str | None], ...]]] = {
    3: (("axis_angle", None), *EULER),
    4: (("quaternion_wxyz", None), ("quaternion_xyzw", None)),
    6: (("rot6d_columns", None), ("rot6d_rows", None)),
    9: (("matrix", None),),
}
"""The forms of rotations of each width, with the axes of Euler angles."""
_SHARP: Final = 2.0
"""Least sharpness of the scale at which summed deltas follow the state."""
_GOES_ON: Final = 0.1
"""Share of the steps with a constant command and a moving robot that shows a lag."""
_EXACT: Final = 2e-3
"""Errors below which each command is reached in its step; then deltas to state and to the last command are the same."""


def format_form(form: tuple[str, str | None], *, degrees: bool = False) -> str:
    """Return a rotation form as text."""
    return " ".join([form[0], *([form[1]] if form[1] else []), *(["in degrees"] if degrees else [])])


@dataclass(frozen=True)
class Reference:
    """What an action is relative to.

    Attributes:
        value: absolute, delta_state or delta_command; None where it cannot be determined.
        errors: error of each.
        follow: how the state follows the best.
        margin: over the second best.
        alike: whether deltas to the state and to the last command explain the motion equally well.
    """

    value: str | None
    errors: Mapping[str, float]
    follow: Follow
    margin: float
    alike: bool = False
    extra: Mapping[str, Any] = field(default_factory=dict)


def choose_reference(follows: Mapping[str, Follow], sharp: float, *, is_seen: bool = True) -> Reference:
    """Choose the reference of actions by how well each hypothesis explains the motion.

    Args:
        follows: of absolute, delta_state and delta_command.
        sharp: sharpness of summed deltas, see `tracking.sharpness`.
        is_seen: whether the robot keeps moving while its command is constant. Without that, deltas to the state whose
            scale is unknown sum up to the motion at some scale, too.
    """
    errors = {name: one.error for name, one in follows.items()}
    best = min(errors, key=lambda name: errors[name])
    floor = 1e-4
    if best != ABSOLUTE and errors[DELTA_COMMAND] <= tracking.PLAIN and sharp >= _SHARP:
        is_reached = errors[DELTA_STATE] < _EXACT and abs(follows[DELTA_STATE].gain - 1) < 0.05
        if is_reached or not is_seen:
            return Reference(None, errors, follows[DELTA_STATE], 1.0, alike=True)
        others = min(errors[ABSOLUTE] / max(errors[DELTA_COMMAND], floor), sharp)
        return Reference(DELTA_COMMAND, errors, follows[DELTA_COMMAND], others)
    second = min(error for name, error in errors.items() if name != best)
    margin = second / max(errors[best], floor)
    return Reference(best if errors[best] <= tracking.PLAIN else None, errors, follows[best], margin)


def of_numbers(states: Rows, commands: Rows) -> Reference:
    """Return the reference of commands (T, D) that have the unit and order of the state."""
    steps = [here + there for here, there in zip(states, commands, strict=True)]
    summed = tracking.cumulated(states, commands)
    follows = {
        ABSOLUTE: tracking.follow(states, commands, shifts=SHIFTS),
        DELTA_STATE: tracking.follow(states, steps),
        DELTA_COMMAND: tracking.follow(states, summed, shifts=SHIFTS),
    }
    is_summed = follows[DELTA_COMMAND].error <= tracking.PLAIN
    sharp = tracking.sharpness(states, commands, follows[DELTA_COMMAND].shift) if is_summed else 0.0
    return choose_reference(follows, sharp)


def of_scaled(states: Rows, commands: Rows) -> Reference:
    """Return the reference of commands (T, D) whose numbers are each scaled and shifted, as by normalisation."""
    follows_by_reference: dict[str, list[Follow]] = {ABSOLUTE: [], DELTA_STATE: [], DELTA_COMMAND: []}
    sharp, weights, going = [], [], []
    for index in range(states[0].shape[1]):
        here = [rows[:, index : index + 1] for rows in states]
        there = [rows[:, index : index + 1] for rows in commands]
        power = float(sum((np.diff(rows, axis=0) ** 2).sum() for rows in here))
        if power <= 0 or np.ptp(np.concatenate(there)) <= 0:
            continue
        weights.append(power / float(np.var(np.concatenate(here)) or 1.0))
        follows_by_reference[ABSOLUTE].append(tracking.follow(here, fitted(here, there), shifts=SHIFTS))
        rest = most_frequent(np.concatenate(there))
        steps = [rows - rest for rows in there]
        going.append(_goes_on(here, steps))
        follows_by_reference[DELTA_STATE].append(
            tracking.follow(here, [a + b for a, b in zip(here, steps, strict=True)])
        )

        # A delta that sums up to the motion also correlates with it.
        if follows_by_reference[DELTA_STATE][-1].error > tracking.PLAIN:
            follows_by_reference[DELTA_COMMAND].append(Follow(1.0, 0))
            sharp.append(0.0)
            continue
        scale, follow = tracking.scaled(here, steps)
        follows_by_reference[DELTA_COMMAND].append(follow)
        sharp.append(tracking.sharpness(here, steps, follow.shift, scale))
    if not weights:
        return Reference(None, {ABSOLUTE: 1.0, DELTA_STATE: 1.0, DELTA_COMMAND: 1.0}, Follow(1.0, 0), 1.0)
    follows = {
        name: Follow(float(np.average([one.error for one in ones], weights=weights)), ones[0].shift, ones[0].gain)
        for name, ones in follows_by_reference.items()
    }
    return choose_reference(follows, float(np.median(sharp)), is_seen=bool(np.median(going) > _GOES_ON))


def _goes_on(states: Rows, steps: Rows) -> float:
    """Return the share of the rows without a step in which one number (T, 1) of the state keeps moving."""
    speed = np.concatenate([np.abs(np.diff(rows[:, 0])) for rows in states])
    step = np.concatenate([np.abs(rows[:-1, 0]) for rows in steps])
    is_still = step < 1e-6 * max(float(step.max()), 1e-12)
    return float((speed[is_still] > 0.05 * np.quantile(speed, 0.95)).mean()) if is_still.sum() >= 10 else 0.0


def most_frequent(values: np.ndarray) -> float:
    """Return the most frequent number: the value of a delta when nothing moves."""
    edges = np.linspace(values.min(), values.max(), 201)
    counts, _ = np.histogram(values, edges)
    bin_index = int(counts.argmax())
    inside = values[(values >= edges[bin_index]) & (values <= edges[bin_index + 1])]
    return float(np.median(inside))


def fitted(states: Rows, commands: Rows) -> list[np.ndarray]:
    """Fit commands of one number (T, 1) to the state some steps later by a scale and an offset."""
    best: tuple[float, float, float] = (np.inf, 1.0, 0.0)
    for lag in range(min(6, min(map(len, states)) // 2)):
        x = np.concatenate([rows[: len(rows) - lag, 0] for rows in commands])
        y = np.concatenate([rows[lag:, 0] for rows in states])
        spread = float(np.var(x))
        scale = float(np.cov(x, y, bias=True)[0, 1]) / spread if spread > 0 else 0.0
        shift = float(y.mean() - scale * x.mean())
        error = float(np.mean((y - scale * x - shift) ** 2))
        if error < best[0]:
            best = (error, scale, shift)
    return [best[1] * rows + best[2] for rows in commands]


def order_of(states: Rows, commands: Rows) -> tuple[tuple[int, ...], float]:
    """Return which number of the commands moves which number of the state, and the margin over other pairings.

    Returns:
        for each number of the state the index of its command; the least ratio of the error of the best other pairing
        to that of this one.
    """
    from scipy.optimize import linear_sum_assignment

    width = states[0].shape[1]
    errors = np.ones((width, width))
    for one in range(width):
        here = [rows[:, one : one + 1] for rows in states]
        for other in range(width):
            there = [rows[:, other : other + 1] for rows in commands]
            steps = [a + b - most_frequent(np.concatenate(there)) for a, b in zip(here, there, strict=True)]
            errors[one, other] = min(
                tracking.follow(here, fitted(here, there)).error, tracking.follow(here, steps).error
            )
    rows, columns = linear_sum_assignment(np.log(errors + 1e-4))
    margins = [
        (np.delete(errors[row], column).min() + 1e-4) / (errors[row, column] + 1e-4)
        for row, column in zip(rows, columns, strict=True)
        if width > 1
    ]
    return tuple(map(int, columns)), float(min(margins, default=np.inf))


def of_poses(
    positions: Rows, turns: Mapping[tuple[str, str | None], Rows], moves: Rows, spins: Rows, forms: Sequence[Any]
) -> tuple[HypothesisRanking, HypothesisRanking]:
    """Return how well each hypothesis on pose commands explains the motion, for positions and for rotations.

    Args:
        positions: of the state, (T, 3).
        turns: its rotations (T, 4), in each form in which they may be given.
        moves: position (T, 3) of the commands.
        spins: their rotation (T, width).
        forms: in which the rotations of the commands may be given.
    """
    errors: dict[tuple[tuple[str, Any], ...], float] = {}
    for form, quaternions in turns.items():
        body = [rotation.rotate(q, move) for q, move in zip(quaternions, moves, strict=True)]
        for applied, steps in ((FIXED, moves), (BODY, body)):
            reference = of_numbers(positions, steps)
            for name, error in reference.errors.items():
                if name == ABSOLUTE and applied == BODY:
                    continue
                if name == DELTA_COMMAND and reference.value != DELTA_COMMAND:
                    error = max(error, 1.0)  # noqa: PLW2901 - steps that are summed at any scale say nothing
                if name == DELTA_STATE and (reference.value == DELTA_COMMAND or reference.alike):
                    error = max(error, 1.0) if not reference.alike else error  # noqa: PLW2901 - as for the above
                errors[("reference", name), ("applied", applied), ("state", form)] = error
    spun: dict[tuple[tuple[str, Any], ...], float] = {}
    for form, quaternions in turns.items():
        for own in forms:
            spun |= _rotation_errors(quaternions, spins, own, form)
    return HypothesisRanking(errors, 1e-4), HypothesisRanking(spun, 1e-4)


def _rotation_errors(states: Rows, commands: Rows, form: tuple[str, str | None], state: object) -> dict[Any, float]:
    """Return the error of each hypothesis on rotation commands (T, width) in one form."""
    try:
        quaternions = [rotations.decode(rows, *form) for rows in commands]
    except ConversionError:
        return {}
    errors: dict[Any, float] = {}
    follows: dict[tuple[str, str], Follow] = {}
    summed_fixed = [
        _integrate_rotations(here, steps, body=False) for here, steps in zip(states, quaternions, strict=True)
    ]
    summed_body = [
        _integrate_rotations(here, steps, body=True) for here, steps in zip(states, quaternions, strict=True)
    ]
    readings: dict[tuple[str, str], list[np.ndarray]] = {
        (ABSOLUTE, FIXED): quaternions,
        (DELTA_STATE, FIXED): [rotation.multiply(step, here) for here, step in zip(states, quaternions, strict=True)],
        (DELTA_STATE, BODY): [rotation.multiply(here, step) for here, step in zip(states, quaternions, strict=True)],
        (DELTA_COMMAND, FIXED): summed_fixed,
        (DELTA_COMMAND, BODY): summed_body,
    }
    for (reference, applied), there in readings.items():
        shifts = (0,) if reference == DELTA_STATE else (0, 1, 2)
        follow = tracking.follow(states, there, tracking.turns, shifts)
        key = (("reference", reference), ("applied", applied), ("form", form), ("state", state))
        errors[key] = follow.error
        follows[reference, applied] = follow
    for applied, summed in ((FIXED, False), (BODY, True)):
        _penalise_summed(errors, follows, states, quaternions, applied, body=summed, form=form, state=state)
    return errors


def _penalise_summed(  # noqa: PLR0913 - what a reading consists of
    errors: dict[Any, float],
    follows: Mapping[tuple[str, str], Follow],
    states: Rows,
    quaternions: Rows,
    applied: str,
    *,
    body: bool,
    form: object,
    state: object,
) -> None:
    """Reject deltas to the state where summed rotations follow the state at their own scale only."""
    key = (("reference", DELTA_STATE), ("applied", applied), ("form", form), ("state", state))
    summed, counted = follows[DELTA_COMMAND, applied], follows[DELTA_STATE, applied]
    if summed.error > tracking.PLAIN or (counted.error < _EXACT and abs(counted.gain - 1) < 0.05):
        return
    longer = [rotation.from_axis_angle(1.25 * rotation.to_axis_angle(rows)) for rows in quaternions]
    other = [_integrate_rotations(here, steps, body=body) for here, steps in zip(states, longer, strict=True)]
    if tracking.follow(states, other, tracking.turns, (summed.shift,)).error > _SHARP * summed.error:
        errors[key] = max(errors[key], 1.0)


def _integrate_rotations(states: np.ndarray, steps: np.ndarray, *, body: bool) -> np.ndarray:
    """Return rotations (T, 4) that start at the state and add one delta per step."""
    at, trajectory = states[0], []
    for step in steps:
        at = rotation.multiply(at, step) if body else rotation.multiply(step, at)
        trajectory.append(at)
    return np.stack(trajectory)
