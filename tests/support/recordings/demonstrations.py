"""Sets of demonstrations in memory, and real motion written under conventions of one's choice."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import get_embodiment
from xpl.conventions import rotation as rotations
from xpl.convert.frames import PoseFrame
from xpl.rotation import conjugate, multiply, rotate
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo

if TYPE_CHECKING:
    from tests.support.recordings.motion import Motion


@dataclass
class MemoryEpisode:
    """An episode that lies in memory; arrays have a leading time axis."""

    key: str
    numbers: dict[str, np.ndarray]
    images: dict[str, np.ndarray] = field(default_factory=dict)
    instructions: tuple[str, ...] = ("Lift the cube.",)
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    extras: dict[str, Any] = field(default_factory=dict)

    @property
    def length(self) -> int:
        """Steps."""
        return len(next(iter(self.numbers.values())))

    @property
    def columns(self) -> dict[str, ColumnInfo]:
        """The columns."""
        return {
            name: ColumnInfo(rows.shape[1:], str(rows.dtype), self.names.get(name, ()))
            for name, rows in self.numbers.items()
        }

    @property
    def cameras(self) -> dict[str, CameraInfo]:
        """The cameras."""
        return {name: CameraInfo(rows.shape[1], rows.shape[2]) for name, rows in self.images.items()}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        return self.numbers[column][start:stop]

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Yield images of a camera."""
        yield from self.images[camera][start:stop]


@dataclass
class MemorySet:
    """A set that lies in memory."""

    episodes: list[MemoryEpisode]
    rate_hz: float | None = None
    robot: str | None = None
    path: str = "memory"
    format: str = "memory"
    is_forkable: bool = True
    extras: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """How many episodes there are."""
        return len(self.episodes)

    def __getitem__(self, index: int) -> MemoryEpisode:
        """Return an episode."""
        return self.episodes[index]


@dataclass(frozen=True)
class Convention:
    """How a set is written.

    Attributes:
        state, action: parts in their order: joints, position, rotation, gripper, fingers.
        form, euler: of rotations; degrees: of Euler angles.
        reference, applied: of actions; grippers are absolute.
        unit: rad of one number of the joints.
        order: which joint is written at each place; action_order likewise for actions.
        frame, point, length: of poses; m of one number.
        gripper: values of closed and open, of the state and of the action.
        normalise: None, min_max or mean_std: actions.
        separate: each part is a column of its own, as robomimic has it.
        every: one step of so many is kept.
        late: steps by which actions are written down early: they come into effect so much later.
        stamps: name and unit of a column of times.
        named: whether numbers have names.
    """

    state: tuple[str, ...] = ("joints", "gripper")
    action: tuple[str, ...] = ("joints", "gripper")
    form: str = "quaternion_wxyz"
    euler: str | None = None
    degrees: bool = False
    reference: str = "absolute"
    applied: str = "fixed"
    unit: float = 1.0
    order: tuple[int, ...] | None = None
    action_order: tuple[int, ...] | None = None
    frame: str = "world"
    point: str = "flange"
    length: float = 1.0
    gripper: tuple[float, float] = (0.0, 1.0)
    action_gripper: tuple[float, float] = (0.0, 1.0)
    normalise: str | None = None
    separate: bool = False
    beside: bool = False
    every: int = 1
    late: int = 0
    stamps: tuple[str, float] | None = None
    named: bool = False


def write(motions: Sequence[Motion], convention: Convention, **told: Any) -> MemorySet:
    """Return real motion written under a convention."""
    episodes = [_episode(motion, convention, index) for index, motion in enumerate(motions)]
    if convention.normalise:
        rows = np.concatenate([episode.numbers["action"] for episode in episodes])
        low, high = rows.min(0), rows.max(0)
        middle, span = (low + high) / 2, (high - low) / 2
        if convention.normalise == "mean_std":
            middle, span = rows.mean(0), rows.std(0)
        for episode in episodes:
            span = np.where(span > 0, span, 1.0)
            episode.numbers["action"] = (episode.numbers["action"] - middle) / span
    return MemorySet(episodes, **told)


def _episode(motion: Motion, how: Convention, index: int) -> MemoryEpisode:
    kept = slice(None, None, how.every)
    numbers: dict[str, list[np.ndarray]] = {}
    columns: dict[str, np.ndarray] = {}
    for side in motion.joints:
        prefix = "" if side == "single" else f"{side}_"
        frames = _arm(motion, side, how, "state")
        targets = _arm(motion, side, how, "action")
        frames = {name: rows[kept] for name, rows in frames.items()}
        targets = {name: rows[kept] for name, rows in targets.items()}
        if how.late:
            targets = {
                name: np.concatenate([rows[how.late :], np.repeat(rows[-1:], how.late, 0)])
                for name, rows in targets.items()
            }
        said = _counted(frames, targets, how)
        written = {name: _written(name, rows, how, how.gripper, how.order) for name, rows in frames.items()}
        order = how.action_order or how.order
        for name in how.state:
            if how.separate:
                columns[f"obs/{prefix}{name}"] = written[name]
            else:
                numbers.setdefault("observation.state", []).append(written[name])
        if how.beside:
            columns[f"observation.{prefix}joints"] = written["joints"]
        for name in how.action:
            numbers.setdefault("action", []).append(
                _written(name, said[name], how, how.action_gripper, order, said=True)
            )
    columns |= {name: np.concatenate(parts, axis=1) for name, parts in numbers.items()}
    if how.stamps:
        name, scale = how.stamps
        columns[name] = np.arange(len(columns["action"]))[:, None] * (how.every / 25.0) * scale
    images = {name: rows[kept] for name, rows in motion.images.items()}
    names = _names(motion, how) if how.named else {}
    return MemoryEpisode(f"episode_{index:06d}", columns, images, (motion.instruction,), names)


def _names(motion: Motion, how: Convention) -> dict[str, tuple[str, ...]]:
    """Return names of numbers as LeRobot has them."""
    count = len(get_embodiment(motion.robot).arms[0].joint_names or ())
    names = {
        "joints": [f"joint_{number}" for number in range(1, count + 1)],
        "gripper": ["gripper"],
        "position": ["x", "y", "z"],
        "rotation": [f"r{number}" for number in range(rotations.WIDTHS[how.form])],
        "fingers": ["finger_1", "finger_2"],
    }
    said = {"observation.state": how.state, "action": how.action}
    sides = ["" if side == "single" else f"{side}_" for side in motion.joints]
    return {
        column: tuple(f"{side}{name}" for side in sides for part in parts for name in names[part])
        for column, parts in said.items()
    }


def _arm(motion: Motion, side: str, how: Convention, role: str) -> dict[str, np.ndarray]:
    joints, opening, flange = (
        (motion.joints, motion.opening, motion.poses)
        if role == "state"
        else (motion.commands, motion.grip, motion.targets)
    )
    robot = get_embodiment(motion.robot)
    pose = PoseFrame(robot, side, how.point, how.frame).encode(flange[side])
    grip = np.asarray(opening[side], np.float64)[:, None]
    return {
        "joints": joints[side].astype(np.float64),
        "position": pose[:, :3],
        "rotation": pose[:, 3:],
        "gripper": grip,
        "fingers": grip,
    }


def _counted(seen: dict[str, np.ndarray], expected: dict[str, np.ndarray], how: Convention) -> dict[str, np.ndarray]:
    """Return commands as they are counted: rotations as quaternions still."""
    if how.reference == "absolute":
        return expected
    before = {name: np.concatenate([seen[name][:1], rows[:-1]]) for name, rows in expected.items()}
    base = seen if how.reference == "delta_state" else before
    said = dict(expected)
    said["joints"] = expected["joints"] - base["joints"]
    move = expected["position"] - base["position"]
    turn = multiply(expected["rotation"], conjugate(base["rotation"]))
    if how.applied == "body":
        move = rotate(conjugate(base["rotation"]), move)
        turn = multiply(conjugate(base["rotation"]), expected["rotation"])
    said["position"], said["rotation"] = move, turn
    return said


def _written(
    name: str, rows: np.ndarray, how: Convention, ends: tuple[float, float], order: Any, *, said: bool = False
) -> np.ndarray:
    """Return a part in the convention's numbers."""
    if name == "joints":
        return (rows[:, list(order)] if order else rows) / how.unit
    if name == "position":
        return rows / how.length
    if name == "rotation":
        paths = rotations.encode(rows, how.form, how.euler)
        return np.rad2deg(paths) if how.degrees else paths
    value = ends[0] + rows * (ends[1] - ends[0])
    if name == "fingers":
        return np.concatenate([value / 2, -value / 2], axis=1)
    return value
