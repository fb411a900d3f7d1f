"""One arm of ManiSkill: its state in the standard's terms, and the command of its controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.poses import compose, invert, pose

from .control import Control, ControllerCommand

if TYPE_CHECKING:
    from numpy.typing import NDArray

_STROKE = 0.08  # m between Franka's fingers when they are open


class Fingers:
    """Franka's fingers: ManiSkill's -1 presses them 1 cm past each other, +1 opens them by 4 cm each."""

    def __init__(self, _agent: Any) -> None:
        pass

    def opening(self, angles: NDArray[np.float64]) -> float:
        """Return the opening between 0 and 1."""
        return float(np.clip((angles[-2] + angles[-1]) / _STROKE, 0.0, 1.0))

    def command(self, opening: float) -> list[float]:
        """Return the command of the fingers' controller."""
        return [2.0 * opening - 1.0]

    def change(self, opening: float, _range: NDArray[np.float64]) -> list[float]:
        """Return the same: where the arm takes changes, the fingers do not."""
        return self.command(opening)

    def opening_for(self, command: NDArray[np.float64]) -> float:
        """Return the opening of a command."""
        return float(command[0] + 1.0) / 2.0


class Stick:
    """A stick in place of fingers: it reads as closed, and takes no command."""

    def __init__(self, _agent: Any) -> None:
        pass

    def opening(self, _angles: NDArray[np.float64]) -> float:
        """Return 0."""
        return 0.0

    def command(self, _opening: float) -> list[float]:
        """Return nothing."""
        return []

    def change(self, _opening: float, _range: NDArray[np.float64]) -> list[float]:
        """Return nothing."""
        return []

    def opening_for(self, _command: NDArray[np.float64]) -> float:
        """Return 0."""
        return 0.0


class Jaw:
    """The turning jaw of an SO-100: a joint among the others, closed at its lower limit."""

    def __init__(self, agent: Any) -> None:
        self._low, self._high = (float(end) for end in agent.robot.get_qlimits()[0, -1])

    def opening(self, angles: NDArray[np.float64]) -> float:
        """Return the opening between 0 and 1."""
        self._now = float(angles[-1])
        return float(np.clip((self._now - self._low) / (self._high - self._low), 0.0, 1.0))

    def command(self, opening: float) -> list[float]:
        """Return the angle of the jaw, rad."""
        return [self._low + opening * (self._high - self._low)]

    def change(self, opening: float, largest: NDArray[np.float64]) -> list[float]:
        """Return how far the jaw goes towards an opening in one step."""
        (command,) = self.command(opening)
        return [float(np.clip((command - self._now) / largest[-1], -1.0, 1.0))]

    def opening_for(self, command: NDArray[np.float64]) -> float:
        """Return the opening that an angle of the jaw is."""
        return float(np.clip((command[0] - self._low) / (self._high - self._low), 0.0, 1.0))


_KINDS: dict[str, tuple[type[Fingers | Stick | Jaw], str]] = {
    "panda": (Fingers, "panda_link8"),
    "panda_wristcam": (Fingers, "panda_link8"),
    "panda_stick": (Stick, "panda_link8"),
    "so100": (Jaw, "Fixed_Jaw"),
}
"""Robots of ManiSkill: what they grip with, and the link that is the flange."""


class Arm:
    """One agent of a scene.

    Args:
        agent: ManiSkill's.
        prefix: of the arm's keys.
        dof: number of joints, without those of the gripper.
        control: how it is commanded.

    Attributes:
        base: pose (7,) of its base in the world.
        state: the standard's state, without prefix, as `look` found it.
        gripper: what it grips with.
    """

    def __init__(self, agent: Any, prefix: str, dof: int, control: Control) -> None:
        self.agent, self.prefix, self._dof, self._control = agent, prefix, dof, control
        kind, flange = _KINDS[agent.uid]
        self.gripper = kind(agent)
        self._flange = agent.robot.links_map[flange]

    def begin(self) -> None:
        """Take in how an episode begins."""
        self.base = _pose(self.agent.robot.pose)
        self.look()
        self._tool = compose(invert(self.state[spec.State.EE_POSE]), self.state[spec.State.TCP_POSE])
        self._control.begin(self)

    def look(self) -> None:
        """Take in the present moment."""
        angles = self.agent.robot.get_qpos()[0].numpy().astype(np.float64)
        self.state: Mapping[str, NDArray[np.float64]] = {
            spec.State.ARM_JOINT_STATE: angles[: self._dof],
            spec.State.EE_JOINT_STATE: np.array([self.gripper.opening(angles)]),
            spec.State.EE_POSE: _pose(self._flange.pose),
            spec.State.TCP_POSE: _pose(_tcp(self.agent)),
        }

    def reached(self, flange: Any) -> NDArray[np.float64]:
        """Return where the point between the fingers is in the base, for a pose (7,) of the flange in the world."""
        return compose(invert(self.base), compose(np.asarray(flange, dtype=np.float64), self._tool))

    def controller_command(self, action: Mapping[str, Any]) -> ControllerCommand:
        """Return the command of ManiSkill's controller for this arm's part of an action."""
        return self._control.controller_command(
            {name.removeprefix(self.prefix): value for name, value in action.items()}, self
        )

    @property
    def largest_change(self) -> NDArray[np.float64]:
        """How far the joints move in one step for an action of 1, rad, where the controller takes changes."""
        controller = self.agent.controller
        config = getattr(controller, "controllers", {"arm": controller})["arm"].config
        return np.broadcast_to(np.asarray(config.upper, dtype=np.float64), len(config.joint_names))


def _tcp(agent: Any) -> Any:
    """Return the pose of a robot's tool; robots of ManiSkill have it in one of two attributes."""
    try:
        return agent.tcp_pose
    except AttributeError:
        return agent.tcp.pose


def _pose(seen: Any) -> NDArray[np.float64]:
    """Return a pose (7,) of ManiSkill's, which is [x, y, z, w, i, j, k] as the standard's."""
    raw = seen.raw_pose[0].numpy().astype(np.float64)
    return pose(raw[: spec.POSITION_DIM], raw[spec.POSITION_DIM :])
