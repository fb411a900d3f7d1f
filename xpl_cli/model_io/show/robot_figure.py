"""The robot as a stick figure, with the poses that a model reads and commands drawn as axes on it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import _spec as sdk
from xpl import poses, rotation
from xpl.conventions.frame import mount
from xpl.convert import ConversionError
from xpl.kinematics import Chain, KinematicsError
from xpl_cli.model_io.show.drawing import DotShape, LineShape, Shape, TextShape, VectorFigure

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from xpl import Embodiment
    from xpl.contract import Action, Entry, State
    from xpl.convert.vectors import ModelVector

_WIDTH, _HEIGHT, _MARGIN, _TITLE = 420.0, 380.0, 34.0, 22.0
_VIEWS: Final = {
    "from the front": ((0.906, 0.423, 0.0), (0.152, -0.326, 0.933)),
    "from above": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "from the right": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}
"""Directions of the world to the right and upwards, of each panel."""
_STILL: Final = poses.pose(np.zeros(sdk.POSITION_DIM), rotation.identity())
_GRID_M: Final = 0.2


@dataclass(frozen=True)
class Mark:
    """A pose that is drawn.

    Attributes:
        pose: (7,) in the world.
        label: what it is.
        start: where the model's numbers count from, (3,) in the world; None where they are the standard's.
    """

    pose: np.ndarray
    label: str
    start: np.ndarray | None = None


@dataclass(frozen=True)
class ReadVector:
    """A vector that the model reads.

    Attributes:
        input: the model's name for it.
        entry: of the block.
        vector: compiled from it.
        numbers: the model's, before normalisation.
    """

    input: str
    entry: Entry
    vector: ModelVector
    numbers: np.ndarray


@dataclass
class WorldDrawing:
    """What is in the world: lines of the robot, poses, and the way of a command."""

    links: list[np.ndarray] = field(default_factory=list)
    wanted: list[np.ndarray] = field(default_factory=list)
    paths: list[np.ndarray] = field(default_factory=list)
    marks: list[Mark] = field(default_factory=list)
    bases: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def points(self) -> np.ndarray:
        """Everything, (N, 3)."""
        marks = [mark.pose[None, :3] for mark in self.marks]
        starts = [mark.start[None] for mark in self.marks if mark.start is not None]
        bases = [base[None, :3] for base in self.bases.values()]
        return np.concatenate([*self.links, *self.wanted, *self.paths, *marks, *starts, *bases])


def figures(
    robot: Embodiment,
    state: State,
    vectors: Sequence[ReadVector],
    steps: Sequence[Action],
) -> list[VectorFigure]:
    """Return the robot from three sides.

    Args:
        robot: the robot.
        state: the standard's.
        vectors: that the model reads.
        steps: of the standard, that are commanded; may be empty.
    """
    drawn = WorldDrawing()
    chain = _chain(robot)
    for side, arm in zip(robot.data["arms"], robot.arms, strict=True):
        base = _mount(robot, side)
        drawn.bases[side] = base
        if chain is not None:
            drawn.links += _stick(robot, chain, base, state, arm.prefix)
            drawn.wanted += _stick(robot, chain, base, steps[-1], arm.prefix) if steps else []
        drawn.paths += _path(chain, base, steps, arm.prefix)
    for one in vectors:
        drawn.marks += _marks(robot, one, state)
    if not drawn.marks:
        drawn.marks += [
            Mark(np.asarray(state[key], np.float64), f"{key} of the standard")
            for key in (f"{arm.prefix}{sdk.State.EE_POSE}" for arm in robot.arms)
            if key in state
        ]
    return [_figure(drawn, name, *axes) for name, axes in _VIEWS.items()]


def _chain(robot: Embodiment) -> Chain | None:
    try:
        return Chain.from_embodiment(robot.data)
    except KinematicsError:
        return None


def _mount(robot: Embodiment, side: str) -> np.ndarray:
    try:
        return mount(robot, side)
    except ConversionError:
        return _STILL


def _stick(robot: Embodiment, chain: Chain, base: np.ndarray, fields: State, prefix: str) -> list[np.ndarray]:
    """Return the links and the fingers of an arm whose joints are known, as lines in the world."""
    key = prefix + sdk.State.ARM_JOINT_STATE
    if key not in fields:
        return []
    joints = np.asarray(fields[key], np.float64)
    links = np.concatenate([np.zeros((1, 3)), chain.points(joints)])
    lines = [poses.transform(base, links)]
    flange = poses.compose(base, chain.flange(joints))
    opening = fields.get(prefix + sdk.State.EE_JOINT_STATE)
    effector = robot.data["end_effector"]
    if opening is None or effector["kind"] != "parallel_gripper" or not effector.get("tcp"):
        return lines
    tip, slide = np.asarray(effector["tcp"]["xyz"]), np.asarray(effector.get("slide_axis") or (0.0, 1.0, 0.0))
    for sign in (-1, 1):
        apart = sign * slide * float(np.asarray(opening)[0]) * (effector.get("stroke") or 0.08) / 2
        lines.append(poses.transform(flange, np.stack([np.zeros(3), 0.4 * tip + apart, tip + apart])))
    return lines


def _path(chain: Chain | None, base: np.ndarray, steps: Sequence[Action], prefix: str) -> list[np.ndarray]:
    """Return the way of the flange that an arm's commands ask for."""
    joint, pose = prefix + sdk.State.ARM_JOINT_STATE, prefix + sdk.State.EE_POSE
    if steps and pose in steps[0]:
        return [np.stack([np.asarray(step[pose], np.float64)[:3] for step in steps])]
    if steps and joint in steps[0] and chain is not None:
        return [
            np.stack([poses.compose(base, chain.flange(np.asarray(step[joint], np.float64)))[:3] for step in steps])
        ]
    return []


def _marks(robot: Embodiment, read_vector: ReadVector, state: State) -> Iterator[Mark]:
    """Yield the poses that a vector's numbers say, where its block says that they are."""
    vector = read_vector.vector
    pieces = {item.label: values for item, values in vector.split(read_vector.numbers)}
    for entry_part, item in zip(read_vector.entry["parts"], vector.parts, strict=True):
        ((kind, how),) = entry_part.items()
        if kind != "position":
            continue
        turn = next((one for one in vector.parts if one.kind == "rotation" and one.key == item.key), None)
        outer = _mount(robot, how["arm"]) if how.get("frame") == "base" else _STILL
        position = poses.transform(outer, item.write(pieces[item.label]))
        if turn is not None:
            turned = rotation.multiply(outer[sdk.POSITION_DIM :], turn.write(pieces[turn.label]))
        else:
            turned = np.asarray(state[item.key], np.float64)[sdk.POSITION_DIM :]
        description = (
            f"{read_vector.input}: {how['arm']} {how.get('point', 'flange')} in the {how.get('frame', 'world')}"
        )
        yield Mark(poses.pose(position, turned), description, outer[: sdk.POSITION_DIM])


def _figure(drawn: WorldDrawing, title: str, right: Sequence[float], up: Sequence[float]) -> VectorFigure:
    """Return one panel."""
    basis = np.array([right, up])
    grid = list(_grid(drawn))
    points = np.concatenate([drawn.points, *grid]) @ basis.T
    low, high = points.min(0), points.max(0)
    span = max(float((high - low).max()), 0.4)
    middle = (low + high) / 2
    scale = (min(_WIDTH, _HEIGHT - _TITLE) - 2 * _MARGIN) / span

    def flat(values: np.ndarray) -> tuple[tuple[float, float], ...]:
        projected = (np.atleast_2d(values) @ basis.T - middle) * scale
        return tuple((_WIDTH / 2 + float(x), (_HEIGHT + _TITLE) / 2 - float(y)) for x, y in projected)

    shapes: list[Shape] = [LineShape("ground", flat(line), 0.8) for line in grid]
    shapes += [LineShape("link", flat(line), 3.0) for line in drawn.links]
    shapes += [DotShape("link", point, 3.4) for line in drawn.links for point in flat(line[:-1])]
    shapes += [LineShape("wanted", flat(line), 1.6, dashed=True) for line in drawn.wanted]
    shapes += [LineShape("wanted", flat(line), 2.2, tip=_long(flat(line))) for line in drawn.paths if len(line) > 1]
    for number, mark in enumerate(drawn.marks):
        if mark.start is not None:
            shapes.append(LineShape("arrow", flat(np.stack([mark.start, mark.pose[:3]])), 1.2, tip=True, dashed=True))
        shapes += _axes(mark.pose, 0.13 * span, flat)
        shapes.append(TextShape("arrow", (8.0, _HEIGHT - 8 - 14 * number), mark.label))
    shapes += [
        TextShape("word", (x, y + 15), name, anchor="middle")
        for name, base in drawn.bases.items()
        for x, y in flat(base[:3])
    ]
    shapes.append(TextShape("word", (8.0, 15.0), title, 12.5))
    shapes += _compass(basis)
    return VectorFigure(_WIDTH, _HEIGHT, tuple(shapes), f"The robot {title}")


def _axes(pose: np.ndarray, length: float, flat: Any) -> Iterator[Shape]:
    tips = poses.transform(pose, length * np.eye(3))
    for name, tip in zip("xyz", tips, strict=True):
        start, end = flat(np.stack([pose[:3], tip]))
        yield LineShape(name, (start, end), 2.4, tip=True)
        yield TextShape(name, (end[0] + 4, end[1] - 2), name)


def _compass(basis: np.ndarray) -> Iterator[Shape]:
    """Yield the world's own directions, in the upper right corner."""
    centre = (_WIDTH - 40, 44.0)
    for name, (x, y) in zip("xyz", basis.T, strict=True):
        end = (centre[0] + 24 * float(x), centre[1] - 24 * float(y))
        if np.hypot(x, y) > 0.1:
            yield LineShape(name, (centre, end), 1.4, tip=True)
            yield TextShape(name, (centre[0] + 33 * float(x) - 3, centre[1] - 33 * float(y) + 4), name, 10)
    yield TextShape("word", (centre[0], centre[1] + 42), "world", 10, "middle")


def _grid(drawn: WorldDrawing) -> Iterator[np.ndarray]:
    """Yield lines of the ground on which the arms stand."""
    height = float(np.mean([base[2] for base in drawn.bases.values()]))
    robot = np.concatenate([*drawn.links, *drawn.paths, *(base[None, :3] for base in drawn.bases.values())])
    low, high = np.floor(robot[:, :2].min(0) / _GRID_M), np.ceil(robot[:, :2].max(0) / _GRID_M)
    ends = np.array([low, high]) * _GRID_M
    for axis in (0, 1):
        for coordinate in np.arange(low[axis], high[axis] + 1) * _GRID_M:
            line = np.array([[0.0, 0.0, height], [0.0, 0.0, height]])
            line[:, axis], line[:, 1 - axis] = coordinate, ends[:, 1 - axis]
            yield line


def _long(points: Iterable[tuple[float, float]]) -> bool:
    """Tell whether a drawn way is long enough for a tip."""
    first, *_, last = points
    return bool(np.hypot(last[0] - first[0], last[1] - first[1]) > 6)
