"""Classification of a column's numbers as joints, position, rotation or gripper, by properties that only these have.

A rotation of four, six or nine numbers has unit lengths and right angles. A gripper moves in few steps. The remaining
six or seven numbers belong to an arm.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl_cli.data.probe.answer import MARGIN
from xpl_cli.data.probe.sample import words

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.data.probe.sample import Series

JOINTS, POSITION, ROTATION, GRIPPER, ARM, THREE, UNKNOWN = (
    "joints",
    "position",
    "rotation",
    "gripper",
    "arm",
    "three",
    "unknown",
)
"""Kinds of parts. `arm`: six numbers, joints or a pose; `three`: a position or a rotation."""
_UNIT: Final = 2e-3
"""Tolerance of unit lengths and right angles: numbers are stored with three digits or more."""
_GAP: Final = 1.5
"""Least ratio of the share of steps in which any arm number moves to that of a gripper."""
_JUMP: Final = 2.5
"""Change of an angle in one step, rad, that no arm makes: the angle wraps around."""
_TURN: Final = 2 * np.pi
_SIZES: Final = (
    (9, ("matrix",)),
    (6, ("rot6d_columns", "rot6d_rows")),
    (4, ("quaternion_wxyz", "quaternion_xyzw")),
)
_ARMS: Final = (7, 6, 5)
_STILL: Final = 1e-9
_GRIPPERS: Final = frozenset(("gripper", "grippers", "finger", "fingers", "jaw"))
_NUMBERED: Final = re.compile(r"(robot|arm)\d")


@dataclass(frozen=True)
class VectorPart:
    """Consecutive numbers of a column.

    Attributes:
        kind: one of the kinds above.
        series: the column.
        start, stop: which of its numbers.
        arm: which arm, counted in the order of the columns.
        side: left, right, or None where no name has it.
        forms: possible forms of a rotation, by its width.
    """

    kind: str
    series: Series
    start: int
    stop: int
    arm: int = 0
    side: str | None = None
    forms: tuple[str, ...] = ()

    @property
    def width(self) -> int:
        """How many numbers."""
        return self.stop - self.start

    @property
    def rows(self) -> list[np.ndarray]:
        """The numbers by episode, (T, width)."""
        return [rows[:, self.start : self.stop] for rows in self.series.rows]

    @property
    def stacked(self) -> np.ndarray:
        """The numbers of all episodes."""
        return self.series.stacked[:, self.start : self.stop]

    @property
    def subject(self) -> str:
        """Its label: `action[0:7]`; the column's name alone where it spans the whole column."""
        if self.width == self.series.width:
            return self.series.name
        return f"{self.series.name}[{self.start}:{self.stop}]"

    def cut(self, kind: str, start: int, stop: int, forms: tuple[str, ...] = ()) -> VectorPart:
        """Return numbers `start` to `stop` of it as a part of another kind."""
        return replace(self, kind=kind, start=self.start + start, stop=self.start + stop, forms=forms)


def split_columns(columns: Sequence[Series]) -> list[VectorPart]:
    """Return the parts of columns of one role, in their order, with their arms."""
    parts = [part for series in columns if np.isfinite(series.stacked).all() for part in _parts_of_column(series)]
    sides = list(dict.fromkeys(side for part in parts if (side := _side(part)) is not None))
    numbered = []
    for part in parts:
        side = _side(part)
        own = [one for one in parts if one.series is part.series and one.kind == part.kind]
        arm = sides.index(side) if side is not None else 0 if part.kind == THREE else own.index(part)
        numbered.append(replace(part, arm=arm, side=side if side in {"left", "right"} else None))
    return numbered


def concentration(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return for each number (D,) the share of the steps that contain 90 % of its motion.

    Steps at which an angle wraps around are left out, with those of its neighbours.
    """
    steps = np.abs(np.concatenate([np.diff(episode, axis=0) for episode in rows]))
    steps[wraps_around(rows)] = 0.0
    steps = np.sort(steps, axis=0)[::-1]
    total = steps.sum(0)
    reached = (np.cumsum(steps, 0) < 0.9 * total).sum(0) + 1
    share: np.ndarray = np.where(total > _STILL, reached / len(steps), 0.0)
    return share


def wraps_around(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return the steps (N, D) at which a number that may be an angle, or a neighbour of it, wraps around."""
    steps = np.abs(np.concatenate([np.diff(episode, axis=0) for episode in rows]))
    most = np.abs(np.concatenate(rows)).max(0)
    begun = np.zeros(steps.shape, bool)
    for turn in (2 * np.pi, 360.0):
        begun |= (steps > 0.6 * turn) & (steps < 1.02 * turn) & (most > 0.4 * turn) & (most <= 0.52 * turn)
    beside = begun.copy()
    for shift in (1, 2):
        beside[:, shift:] |= begun[:, :-shift]
        beside[:, :-shift] |= begun[:, shift:]
    return beside


def form_by_wraparound(part: VectorPart) -> tuple[str, str, float] | None:
    """Return the form of three angles by how they wrap around, with evidence and margin; None without a wrap."""
    for unit in (1.0, np.pi / 180):
        count, off = 0, np.zeros(2)
        for rows in part.rows:
            angles = rows * unit
            steps = np.diff(angles, axis=0)
            for row in np.flatnonzero((np.abs(steps) > _JUMP).any(1)):
                before, after = angles[row], angles[row + 1]
                length = float(np.linalg.norm(before))
                jumped = np.abs(steps[row]) > _JUMP
                turned = -before * (_TURN - length) / max(length, 1e-9)
                begun = before - _TURN * np.sign(before) * jumped
                here = np.array([np.linalg.norm(after - turned), np.linalg.norm(after - begun)])
                if here.min() < 0.5:
                    count += 1
                    off += here
        if not count:
            continue
        margin = float(off.max() / max(off.min(), 0.02))
        if margin < 2 * MARGIN:
            return None
        form = "axis_angle" if off[0] < off[1] else "euler"
        what = "one angle wraps around" if form == "euler" else "the vector flips at half a turn"
        return form, f"{what} {count} times, and other forms do not fit there by {off.max() / count:.2g} rad", margin
    return None


def _parts_of_column(series: Series) -> Iterator[VectorPart]:
    """Yield the parts of one column."""
    rotations = _rotations(series.stacked)
    shares = concentration(series.rows)
    edges = [(0, 0), *((start, stop) for start, stop, _ in rotations), (series.width, series.width)]
    for index, ((_, begin), (end, after)) in enumerate(itertools.pairwise(edges)):
        is_before = index < len(rotations)
        yield from _parts_between_rotations(series, begin, end, shares, is_before=is_before)
        if is_before:
            yield VectorPart(ROTATION, series, end, after, forms=rotations[index][2])


def _rotations(rows: np.ndarray) -> list[tuple[int, int, tuple[str, ...]]]:
    """Return start, stop and possible forms of the rotations found by unit lengths and right angles.

    Longer forms come first, and of overlapping ones the best fit: four numbers of a matrix may have unit length, and so
    may a small rotation next to numbers near zero.
    """
    rotations: list[tuple[int, int, tuple[str, ...]]] = []
    free = np.array([not _switches(column) for column in rows.T])
    for size, forms in _SIZES:
        errors = [(_orthonormality_error(rows[:, at : at + size]), at) for at in range(rows.shape[1] - size + 1)]
        for error, at in sorted(errors):
            if error < (_UNIT if size == 4 else 2 * _UNIT) and free[at : at + size].all():
                rotations.append((at, at + size, forms))
                free[at : at + size] = False
    return sorted(rotations)


def _switches(values: np.ndarray) -> bool:
    """Tell whether numbers have few values far apart, like gripper commands: a 1 next to deltas is no quaternion."""
    return float(np.ptp(values)) > 0.5 and len(np.unique(values.round(6))) <= 3


def _orthonormality_error(rows: np.ndarray) -> float:
    """Return the deviation of rows from unit quaternions, or from two or three orthonormal axes."""
    width = rows.shape[1]
    if width == 4:
        moves = (np.ptp(rows, axis=0) > _STILL).sum()
        return float(np.abs(np.linalg.norm(rows, axis=1) - 1).max()) if moves >= 2 or _is_turn(rows[0]) else np.inf
    axes = rows.reshape(len(rows), -1, 3)
    products = np.einsum("nij,nkj->nik", axes, axes)
    return float(np.abs(products - np.eye(width // 3)).max())


def _is_turn(row: np.ndarray) -> bool:
    """Tell whether a constant quaternion is more than a unit vector: at least two numbers are not zero."""
    return bool((np.abs(row) > _UNIT).sum() >= 2)


def _parts_between_rotations(
    series: Series, begin: int, end: int, shares: np.ndarray, *, is_before: bool
) -> Iterator[VectorPart]:
    """Yield the parts of the numbers between two rotations."""
    width = end - begin
    if not width:
        return
    position_width = 3 if is_before and width >= 3 else 0
    other_width = width - position_width
    layout = _layout_by_names(series, begin, begin + other_width)
    layout = layout or _layout(shares[begin : begin + other_width], followed=bool(position_width), preceded=begin > 0)
    if layout in ([(JOINTS, 7)], [(JOINTS, 7)] * 2) and not _says_joints(series):
        layout = [(UNKNOWN, other_width)]  # the seventh may be a gripper that hardly moves
    if wraps_around([rows[:, begin : begin + other_width] for rows in series.rows]).any():
        layout = [(UNKNOWN if kind == JOINTS else kind, size) for kind, size in layout]  # joints do not wrap around
    at = begin
    for kind, size in layout:
        yield VectorPart(kind, series, at, at + size)
        at += size
    if position_width:
        yield VectorPart(POSITION, series, at, at + position_width)


def _layout_by_names(series: Series, begin: int, end: int) -> list[tuple[str, int]]:
    """Return the layout by the file's names of grippers; empty where it names none."""
    is_gripper = [bool(set(words(name)) & _GRIPPERS) for name in series.names[begin:end]]
    if len(is_gripper) != end - begin or not any(is_gripper):
        return []
    runs = [(is_hand, len(list(group))) for is_hand, group in itertools.groupby(is_gripper)]
    kinds = {3: THREE, 5: JOINTS, 6: ARM, 7: JOINTS}
    return [(GRIPPER, size) if is_hand else (kinds.get(size, UNKNOWN), size) for is_hand, size in runs]


def _says_joints(series: Series) -> bool:
    """Tell whether the file names all numbers of a column as joints."""
    names = series.names or (series.name,)
    return all(any(name_word.startswith("joint") or name_word == "qpos" for name_word in words(name)) for name in names)


def _layout(shares: np.ndarray, *, followed: bool, preceded: bool) -> list[tuple[str, int]]:
    """Return the layout of numbers by the shares of steps in which they move.

    Args:
        shares: share of steps that contain 90 % of the motion, for each number.
        followed: whether a pose follows them.
        preceded: whether a rotation precedes them.
    """
    width = len(shares)
    if not width:
        return []
    if width <= 2 and (preceded or followed):
        return [(GRIPPER, width)]
    candidates: list[tuple[float, list[tuple[str, int]]]] = []
    for layout in _layouts(width):
        gripping = np.concatenate([np.full(size, kind == GRIPPER) for kind, size in layout])
        if gripping.all() or not gripping.any():
            continue
        gap = float(shares[~gripping].min() / max(shares[gripping].max(), _STILL))
        candidates.append((gap, layout))
    gap, layout = max(candidates, key=lambda entry: entry[0], default=(0.0, []))
    if gap >= _GAP:
        return layout
    plain = {1: [(GRIPPER, 1)], 2: [(GRIPPER, 2)], 3: [(THREE, 3)], 6: [(ARM, 6)], 12: [(ARM, 6)] * 2}
    plain |= {5: [(JOINTS, 5)], 7: [(JOINTS, 7)], 14: [(JOINTS, 7)] * 2}
    if width <= 2 and shares.max() > 0.25:  # grippers do not move that often
        return [(UNKNOWN, width)]
    return plain.get(width, [(UNKNOWN, width)])


def _layouts(width: int) -> Iterator[list[tuple[str, int]]]:
    """Yield the layouts of a width: one arm with gripper, two in turn, or two arms, then two grippers."""
    if width == 4:
        yield [(THREE, 3), (GRIPPER, 1)]
    for size, fingers in itertools.product(_ARMS, (1, 2)):
        arm = (ARM if size == 6 else JOINTS, size)
        hand = (GRIPPER, fingers)
        for layout in ([arm, hand], [hand, arm], [arm, hand] * 2, [hand, arm] * 2, [arm, arm, hand, hand]):
            if sum(count for _, count in layout) == width:
                yield layout


def _side(part: VectorPart) -> str | None:
    """Return the arm in the name of a column or of its numbers: left, right, or such as robot1."""
    name_words = set(words(part.series.name))
    for name in part.series.names[part.start : part.stop]:
        name_words |= set(words(name))
    sides = name_words & {"left", "right"} or {word for word in name_words if _NUMBERED.fullmatch(word)}
    return sides.pop() if len(sides) == 1 else None
