"""Which numbers of a column are joints, positions, rotations, grippers: by what only these can be.

A rotation of four, six or nine numbers is told by its lengths and right angles. A gripper is told by how it moves: all
of its motion lies in few steps. What is left are six or seven numbers of an arm.
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
"""Kinds of parts. `arm` are six numbers, joints or a pose; `three` are a position or a rotation."""
_UNIT: Final = 2e-3
"""How far lengths and right angles may be off: numbers are stored with three digits and more."""
_GAP: Final = 1.5
"""How many times less of the steps a gripper moves in than any number of an arm."""
_JUMP: Final = 2.5
"""A change of an angle in one step, rad, that no arm makes: the number begins again at the other end."""
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
    """Some numbers of a column.

    Attributes:
        kind: what they are.
        series: the column.
        start, stop: which of its numbers.
        arm: which arm, counted in the order of the columns.
        side: left, right, or None where no name says it.
        forms: of a rotation how it may be written, as far as its width tells.
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
        """How it is told: `action[0:7]`; the column's name alone where it is all of it."""
        if self.width == self.series.width:
            return self.series.name
        return f"{self.series.name}[{self.start}:{self.stop}]"

    def cut(self, kind: str, start: int, stop: int, forms: tuple[str, ...] = ()) -> VectorPart:
        """Return some of its numbers as a part of another kind; places count within it."""
        return replace(self, kind=kind, start=self.start + start, stop=self.start + stop, forms=forms)


def split_columns(columns: Sequence[Series]) -> list[VectorPart]:
    """Return the parts of columns of one role, in their order, with their arms."""
    found = [part for series in columns if np.isfinite(series.stacked).all() for part in _parts_of_column(series)]
    sides = list(dict.fromkeys(side for part in found if (side := _side(part)) is not None))
    numbered = []
    for part in found:
        side = _side(part)
        own = [one for one in found if one.series is part.series and one.kind == part.kind]
        arm = sides.index(side) if side is not None else 0 if part.kind == THREE else own.index(part)
        numbered.append(replace(part, arm=arm, side=side if side in {"left", "right"} else None))
    return numbered


def concentration(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return for each number (D,) in which share of the steps nine tenths of its motion lie.

    Steps in which a number begins again at the other end, as angles do, are left out, with those of its neighbours.
    """
    steps = np.abs(np.concatenate([np.diff(episode, axis=0) for episode in rows]))
    steps[wraps_around(rows)] = 0.0
    steps = np.sort(steps, axis=0)[::-1]
    total = steps.sum(0)
    reached = (np.cumsum(steps, 0) < 0.9 * total).sum(0) + 1
    share: np.ndarray = np.where(total > _STILL, reached / len(steps), 0.0)
    return share


def wraps_around(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return in which steps (N, D) numbers that may be angles begin again at the other end, or stand beside one."""
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
    """Return what the places where numbers begin again tell of the form of three angles, None without any."""
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
        what = "one angle begins again at the other end" if form == "euler" else "the vector turns round at half a turn"
        return form, f"{what} {count} times, and other forms do not fit there by {off.max() / count:.2g} rad", margin
    return None


def _parts_of_column(series: Series) -> Iterator[VectorPart]:
    """Yield the parts of one column."""
    rotations = _rotations(series.stacked)
    shares = concentration(series.rows)
    edges = [(0, 0), *((start, stop) for start, stop, _ in rotations), (series.width, series.width)]
    for place, ((_, begin), (end, after)) in enumerate(itertools.pairwise(edges)):
        is_before = place < len(rotations)
        yield from _parts_between_rotations(series, begin, end, shares, is_before=is_before)
        if is_before:
            yield VectorPart(ROTATION, series, end, after, forms=rotations[place][2])


def _rotations(rows: np.ndarray) -> list[tuple[int, int, tuple[str, ...]]]:
    """Return the places of rotations that their lengths tell, with the forms that they may have.

    The longest are looked for first, and of those that overlap what fits best: some of the numbers of a matrix may have
    the length of a quaternion, and a small turn stands beside numbers near zero.
    """
    found: list[tuple[int, int, tuple[str, ...]]] = []
    free = np.array([not _switches(column) for column in rows.T])
    for size, forms in _SIZES:
        errors = [(_orthonormality_error(rows[:, at : at + size]), at) for at in range(rows.shape[1] - size + 1)]
        for error, at in sorted(errors):
            if error < (_UNIT if size == 4 else 2 * _UNIT) and free[at : at + size].all():
                found.append((at, at + size, forms))
                free[at : at + size] = False
    return sorted(found)


def _switches(values: np.ndarray) -> bool:
    """Tell whether numbers have few values far apart, as a gripper's commands: 1 beside deltas is no quaternion."""
    return float(np.ptp(values)) > 0.5 and len(np.unique(values.round(6))) <= 3


def _orthonormality_error(rows: np.ndarray) -> float:
    """Return how far rows are from quaternions, or from the first two or all three axes of a rotation."""
    width = rows.shape[1]
    if width == 4:
        moves = (np.ptp(rows, axis=0) > _STILL).sum()
        return float(np.abs(np.linalg.norm(rows, axis=1) - 1).max()) if moves >= 2 or _is_turn(rows[0]) else np.inf
    axes = rows.reshape(len(rows), -1, 3)
    products = np.einsum("nij,nkj->nik", axes, axes)
    return float(np.abs(products - np.eye(width // 3)).max())


def _is_turn(row: np.ndarray) -> bool:
    """Tell whether a quaternion that never changes is one that nobody writes otherwise: not all but one are zero."""
    return bool((np.abs(row) > _UNIT).sum() >= 2)


def _parts_between_rotations(
    series: Series, begin: int, end: int, shares: np.ndarray, *, is_before: bool
) -> Iterator[VectorPart]:
    """Yield the parts of numbers between rotations that are known."""
    width = end - begin
    if not width:
        return
    place = 3 if is_before and width >= 3 else 0
    rest = width - place
    layout = _layout_by_names(series, begin, begin + rest)
    layout = layout or _layout(shares[begin : begin + rest], followed=bool(place), preceded=begin > 0)
    if layout in ([(JOINTS, 7)], [(JOINTS, 7)] * 2) and not _says_joints(series):
        layout = [(UNKNOWN, rest)]  # the seventh may be a gripper that hardly moves
    if wraps_around([rows[:, begin : begin + rest] for rows in series.rows]).any():
        layout = [(UNKNOWN if kind == JOINTS else kind, size) for kind, size in layout]  # no joint does that
    at = begin
    for kind, size in layout:
        yield VectorPart(kind, series, at, at + size)
        at += size
    if place:
        yield VectorPart(POSITION, series, at, at + place)


def _layout_by_names(series: Series, begin: int, end: int) -> list[tuple[str, int]]:
    """Return what numbers are where the file's names say which are grippers; nothing where they do not."""
    is_gripper = [bool(set(words(name)) & _GRIPPERS) for name in series.names[begin:end]]
    if len(is_gripper) != end - begin or not any(is_gripper):
        return []
    runs = [(held, len(list(group))) for held, group in itertools.groupby(is_gripper)]
    kinds = {3: THREE, 5: JOINTS, 6: ARM, 7: JOINTS}
    return [(GRIPPER, size) if held else (kinds.get(size, UNKNOWN), size) for held, size in runs]


def _says_joints(series: Series) -> bool:
    """Tell whether the file's names say that all numbers of a column are joints."""
    names = series.names or (series.name,)
    return all(any(word.startswith("joint") or word == "qpos" for word in words(name)) for name in names)


def _layout(shares: np.ndarray, *, followed: bool, preceded: bool) -> list[tuple[str, int]]:
    """Return what numbers are, of which the shares of steps in which they move are known.

    Args:
        shares: of each.
        followed: whether a pose comes behind them.
        preceded: whether a rotation stands before them.
    """
    width = len(shares)
    if not width:
        return []
    if width <= 2 and (preceded or followed):
        return [(GRIPPER, width)]
    found: list[tuple[float, list[tuple[str, int]]]] = []
    for layout in _layouts(width):
        gripping = np.concatenate([np.full(size, kind == GRIPPER) for kind, size in layout])
        if gripping.all() or not gripping.any():
            continue
        gap = float(shares[~gripping].min() / max(shares[gripping].max(), _STILL))
        found.append((gap, layout))
    gap, layout = max(found, key=lambda entry: entry[0], default=(0.0, []))
    if gap >= _GAP:
        return layout
    plain = {1: [(GRIPPER, 1)], 2: [(GRIPPER, 2)], 3: [(THREE, 3)], 6: [(ARM, 6)], 12: [(ARM, 6)] * 2}
    plain |= {5: [(JOINTS, 5)], 7: [(JOINTS, 7)], 14: [(JOINTS, 7)] * 2}
    if width <= 2 and shares.max() > 0.25:  # no gripper moves as often
        return [(UNKNOWN, width)]
    return plain.get(width, [(UNKNOWN, width)])


def _layouts(width: int) -> Iterator[list[tuple[str, int]]]:
    """Yield arms with grippers of so many numbers in all: one, two in turn, or two arms and then two grippers."""
    if width == 4:
        yield [(THREE, 3), (GRIPPER, 1)]
    for size, fingers in itertools.product(_ARMS, (1, 2)):
        arm = (ARM if size == 6 else JOINTS, size)
        hand = (GRIPPER, fingers)
        for layout in ([arm, hand], [hand, arm], [arm, hand] * 2, [hand, arm] * 2, [arm, arm, hand, hand]):
            if sum(count for _, count in layout) == width:
                yield layout


def _side(part: VectorPart) -> str | None:
    """Return which arm the name of a column, or those of its numbers, say: left, right, or such as robot1."""
    said = set(words(part.series.name))
    for name in part.series.names[part.start : part.stop]:
        said |= set(words(name))
    sides = said & {"left", "right"} or {word for word in said if _NUMBERED.fullmatch(word)}
    return sides.pop() if len(sides) == 1 else None
