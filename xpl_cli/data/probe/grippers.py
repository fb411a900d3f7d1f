"""Grippers: range, direction, and how state and command correlate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from xpl_cli.data.probe.answer import ProbeAnswer, unknown
from xpl_cli.data.probe.sample import words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.data.probe.parts import VectorPart

LARGER, SMALLER = "larger is open", "smaller is open"
_GRASPS: Final = frozenset(
    ["pick", "lift", "grasp", "take", "grab", "stack", "place", "put", "pull", "hand", "handover", "hold"]
)
_LEAST: Final = 3
"""Least number of gripper movements."""
_AGREE: Final = 0.9


def probe_gripper(
    state: VectorPart | None, command: VectorPart | None, instructions: Sequence[Sequence[str]]
) -> list[ProbeAnswer]:
    """Return range and direction of an arm's gripper.

    Args:
        state: its state, if recorded.
        command: likewise.
        instructions: of each episode.
    """
    answers = [_range(part) for part in (state, command) if part is not None]
    ends = _open_ends(state, command, instructions)
    for part, direction in zip((state, command), ends, strict=True):
        if part is None:
            continue
        if direction is None:
            why = "no grasp was found that would show the closed end"
            needs = "episodes in which the robot grasps something that its instruction names"
            answers.append(unknown("gripper direction", part.subject, why, needs))
        else:
            answers.append(ProbeAnswer("gripper direction", part.subject, *direction))
    return answers


def _range(part: VectorPart) -> ProbeAnswer:
    """Return the range of a gripper's numbers."""
    rows = part.stacked
    low, high = float(rows[:, 0].min()), float(rows[:, 0].max())
    what = f"it lies between {low:.4g} and {high:.4g}"
    if _is_two_valued(rows[:, 0]):
        what = f"it is {low:.4g} or {high:.4g} and nothing between"
    if part.width == 2:
        other = rows[:, 1]
        turned = float(np.corrcoef(rows[:, 0], other)[0, 1]) if np.ptp(other) > 0 and np.ptp(rows[:, 0]) > 0 else 1.0
        what += f"; the second finger is {'its opposite' if turned < 0 else 'as the first'}"
    return ProbeAnswer("gripper range", part.subject, [low, high], what)


def _is_two_valued(values: np.ndarray) -> bool:
    """Tell whether numbers have two values and nothing between."""
    low, high = float(values.min()), float(values.max())
    if high <= low:
        return False
    near = np.minimum(values - low, high - values) <= 0.02 * (high - low)
    return bool(near.mean() > 0.98)


def _open_ends(
    state: VectorPart | None, command: VectorPart | None, instructions: Sequence[Sequence[str]]
) -> tuple[tuple[str, str, float] | None, tuple[str, str, float] | None]:
    """Return for state and command which end is open, with evidence and margin."""
    lead = command if command is not None else state
    if lead is None:
        return None, None
    turned = _correlation_sign(state, command)
    by_stop = (
        _end_by_blocked_motion(state, command) if state is not None and command is not None and turned == 1 else None
    )
    by_words = _end_by_first_change(lead, instructions)
    if by_stop is not None and by_words is not None and by_stop[0] != by_words[0]:
        return None, None
    verdict = by_stop or by_words
    if verdict is None:
        return None, None
    other = verdict if turned == 1 else (SMALLER if verdict[0] == LARGER else LARGER, *verdict[1:])
    if lead is state:
        return verdict, None
    if state is None or turned == 0:
        return None, verdict
    linked = f"its command is open where it is {'larger' if verdict[0] == LARGER else 'smaller'}, and it follows that"
    return (other[0], f"{linked}{'' if turned == 1 else ' the other way round'}", verdict[2]), verdict


def _correlation_sign(state: VectorPart | None, command: VectorPart | None) -> int:
    """Return the sign of the correlation of state and command; 0 if its magnitude is below 0.6."""
    if state is None or command is None:
        return 1
    best = 0.0
    for lag in range(1, 12):
        one = np.concatenate([rows[: max(len(rows) - lag, 0), 0] for rows in command.rows])
        other = np.concatenate([rows[lag:, 0] for rows in state.rows])
        if len(one) > 10 and np.ptp(one) > 0 and np.ptp(other) > 0:
            correlation = float(np.corrcoef(one, other)[0, 1])
            best = correlation if abs(correlation) > abs(best) else best
    return 0 if abs(best) < 0.6 else int(np.sign(best))


def _end_by_blocked_motion(state: VectorPart, command: VectorPart) -> tuple[str, str, float] | None:
    """Return which end is open by where the gripper is blocked: an object is between its fingers there."""
    low, high = float(command.stacked[:, 0].min()), float(command.stacked[:, 0].max())
    span = high - low
    positions = state.stacked[:, 0]
    if (
        span <= 0
        or positions.min() < low - 0.1 * span
        or positions.max() > high + 0.1 * span
        or np.ptp(positions) < 0.15 * span
    ):
        return None
    short: dict[str, list[float]] = {"low": [], "high": []}
    for here, there in zip(state.rows, command.rows, strict=True):
        for end, at in (("low", low), ("high", high)):
            is_commanded = np.abs(there[:, 0] - at) < 0.02 * span
            for begin, stop in _runs(is_commanded):
                rest = here[begin:stop, 0]
                if stop - begin >= 6 and abs(rest[-1] - rest[-3]) < 0.01 * span:
                    short[end].append(abs(float(rest[-1]) - at) / span)
    if min(map(len, short.values())) < 2:
        return None
    off = {end: float(np.median(values)) for end, values in short.items()}
    closed = max(off, key=lambda end: off[end])
    other = min(off.values())
    if off[closed] < 0.08 or other > 0.03:  # if both ends are off, state and command have different units
        return None
    at = low if closed == "low" else high
    short_by = f"{100 * off[closed]:.0f} % of its range short, at the other end {100 * other:.0f} %"
    evidence = f"commanded to {at:.3g} it stops {short_by}"
    return LARGER if closed == "low" else SMALLER, evidence, off[closed] / max(other, 0.02)


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Return start and stop of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _end_by_first_change(part: VectorPart, instructions: Sequence[Sequence[str]]) -> tuple[str, str, float] | None:
    """Return which end is open by the first movement: episodes that grasp an object close the gripper first."""
    low, high = float(part.stacked[:, 0].min()), float(part.stacked[:, 0].max())
    if high <= low:
        return None
    falls = rises = 0
    for rows, evidence in zip(part.rows, instructions, strict=True):
        if not {word for sentence in evidence for word in words(sentence.replace(" ", "_"))} & _GRASPS:
            continue
        share = (rows[:, 0] - low) / (high - low)
        is_high = share > 0.5
        changes = np.flatnonzero(np.diff(is_high.astype(int)))
        if not len(changes) or changes[0] < 3:
            continue
        falls, rises = (falls + 1, rises) if is_high[0] else (falls, rises + 1)
    count = falls + rises
    if count < _LEAST or max(falls, rises) < _AGREE * count:
        return None
    direction = LARGER if falls > rises else SMALLER
    way = "falls" if falls > rises else "rises"
    evidence = f"in {max(falls, rises)} of {count} episodes whose instruction asks for a grasp it {way} first"
    return direction, evidence, (max(falls, rises) + 1) / (min(falls, rises) + 1)
