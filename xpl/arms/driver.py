"""What an arm's own software has to offer: connect, read, command, hold, let go."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Numbers = Mapping[str, NDArray[np.float64]]
    """Measured or commanded values of an arm by key of the state: rad, and 0..1 for grippers."""


class DriverError(RuntimeError):
    """The arm or a camera cannot be reached, or says something that cannot be."""


@dataclass(frozen=True)
class Picture:
    """What a camera saw.

    Attributes:
        image: (H, W, 3) uint8, RGB.
        at: when it was taken, s on the clock of `time.monotonic`.
    """

    image: NDArray[np.uint8]
    at: float


@dataclass(frozen=True)
class Reading:
    """What an arm and its cameras say.

    Attributes:
        state: of each arm, with its prefix, `arm_joint_state` (dof,) rad and `ee_joint_state` (ee_dim,) 0 to 1.
        at: when it was measured, s on the clock of `time.monotonic`.
        pictures: by the name of the camera in env.yml; one that gave nothing new keeps its last picture and time.
    """

    state: Numbers
    at: float
    pictures: Mapping[str, Picture] = field(default_factory=dict)


class Driver(ABC):
    """One robot, of one or two arms, as its maker's software drives it.

    Methods are called by one thread at a time. Only `command` moves the robot.
    """

    @abstractmethod
    def connect(self) -> None:
        """Reach arm and cameras, without a motion; once, before anything else.

        Raises:
            DriverError: with what is missing.
        """

    @abstractmethod
    def read(self, *, cameras: bool = True) -> Reading:
        """Return what arm and cameras say now.

        Raises:
            DriverError: the arm does not answer.
        """

    @abstractmethod
    def command(self, targets: Numbers) -> None:
        """Send the targets of one control step, and return at once.

        Args:
            targets: as `Reading.state`.

        Raises:
            DriverError: the arm does not take them.
        """

    def hold(self) -> None:
        """Stay where the arm is; by default by commanding the pose that it measures."""
        self.command(self.read(cameras=False).state)

    def estop(self) -> None:
        """Stop at once, by whatever stops this robot best; by default as `hold`."""
        self.hold()

    @abstractmethod
    def close(self) -> None:
        """Let go of arm and cameras. The arm must not fall: it stays powered, or its brakes close."""
