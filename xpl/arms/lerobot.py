"""Any robot that has LeRobot's robot surface: its own SO-101, Koch and OpenArm, and plugins such as Piper and Franka.

The surface is `connect`, `get_observation`, `send_action`, `disconnect`, with flat maps of numbers and images
(huggingface/lerobot, src/lerobot/robots/robot.py). LeRobot itself is imported only by `make`.
"""

from __future__ import annotations

import contextlib
import importlib
import pkgutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.arms.driver import Driver, DriverError, Picture, Reading

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl.arms.driver import Numbers
    from xpl.contract import Entry
    from xpl.embodiment import Embodiment

_PER = {"degrees": float(np.deg2rad(1.0)), "radians": 1.0}


@dataclass(frozen=True)
class MotorNames:
    """What a LeRobot robot calls things, and in which units it counts.

    Attributes:
        joints: keys of the joints of all arms, in the standard's order; by default `<prefix><joint>.pos`.
        grippers: key of each arm's gripper; by default `<prefix>gripper.pos`.
        unit: of joints, "degrees" or "radians".
        closed, open: what the gripper says when it is closed, and open.
        cameras: name in env.yml to LeRobot's key; by default the same names.
    """

    joints: Sequence[str] = ()
    grippers: Sequence[str] = ()
    unit: str = "degrees"
    closed: float = 0.0
    open: float = 100.0
    cameras: Mapping[str, str] = field(default_factory=dict)


def make(kind: str, settings: Entry) -> Any:
    """Return a robot of LeRobot by its type, as `--robot.type` takes it.

    Args:
        kind: such as "so101_follower", or the type of an installed plugin (`lerobot_robot_*`).
        settings: fields of its configuration, such as `port` and `id`.

    Raises:
        DriverError: LeRobot is not installed here, has no such type, or refuses a setting.
    """
    try:
        robots = importlib.import_module("lerobot.robots")
        utils = importlib.import_module("lerobot.utils.import_utils")
    except ImportError as error:
        raise DriverError(f"LeRobot is not installed in this Python: pip install lerobot ({error})") from None
    for name in ("register_third_party_plugins", "register_third_party_devices"):  # as its releases call it
        if hasattr(utils, name):
            getattr(utils, name)()
            break
    try:
        _import_robots(robots, kind)
        config = robots.RobotConfig.get_choice_class(kind)(**settings)
        return robots.make_robot_from_config(config)
    except Exception as error:  # noqa: BLE001 - whatever a plugin raises
        raise DriverError(f"LeRobot makes no robot {kind!r} of {dict(settings)}: {error}") from None


def _import_robots(robots: Any, kind: str) -> None:
    """Import robots that come with LeRobot until one registers the type: a family's module bears no type's name."""
    for module in pkgutil.iter_modules(getattr(robots, "__path__", ())):
        if kind in robots.RobotConfig.get_known_choices():
            return
        if module.ispkg:
            with contextlib.suppress(ImportError):  # another robot's software
                importlib.import_module(f"{robots.__name__}.{module.name}")


class LeRobotDriver(Driver):
    """A robot of LeRobot, in the standard's units.

    Args:
        robot: with LeRobot's surface; not connected.
        embodiment: which robot it is.
        words: what it calls things.

    Raises:
        DriverError: an arm has other joints than the embodiment, or an unknown unit, or counts in percent.
    """

    def __init__(self, robot: Any, embodiment: Embodiment, words: MotorNames | None = None) -> None:
        self._robot, self._embodiment, self._words = robot, embodiment, words or MotorNames()
        self._pictures: dict[str, Picture] = {}
        total = sum(arm.dof for arm in embodiment.arms)
        usual = [f"{arm.prefix}{name}.pos" for arm in embodiment.arms for name in arm.joint_names or ()]
        self._joints = list(self._words.joints) or usual
        self._grippers = list(self._words.grippers) or [f"{arm.prefix}gripper.pos" for arm in embodiment.arms]
        if len(self._joints) != total or len(self._grippers) != len(embodiment.arms):
            raise DriverError(
                f"{embodiment.name} has {total} joints and {len(embodiment.arms)} grippers, and the words name "
                f"{len(self._joints)} and {len(self._grippers)}"
            )
        if self._words.unit not in _PER or self._words.open == self._words.closed:
            raise DriverError(f"expected a unit of {', '.join(_PER)}, and grippers that open: got {self._words}")
        if getattr(getattr(robot, "config", None), "use_degrees", True) is False:
            raise DriverError(f"{robot} counts joints in percent of their ranges: make it with use_degrees=True")
        commands = set(getattr(robot, "action_features", None) or (*self._joints, *self._grippers))
        missing = [key for key in (*self._joints, *self._grippers) if key not in commands]
        if missing:
            raise DriverError(f"the robot takes no {', '.join(missing)}; it takes {', '.join(sorted(commands))}")

    def connect(self) -> None:
        """Connect without calibrating, which moves some robots."""
        config: Any = getattr(self._robot, "config", None)
        if getattr(config, "disable_torque_on_disconnect", None):
            config.disable_torque_on_disconnect = False  # an arm without torque falls
        try:
            self._robot.connect(calibrate=False)
        except Exception as error:  # noqa: BLE001 - whatever a plugin raises
            raise DriverError(f"{self._robot} cannot be connected: {error}") from None
        if not getattr(self._robot, "is_calibrated", True):
            raise DriverError(f"{self._robot} is not calibrated: run lerobot-calibrate, with its options, first")

    def read(self, *, cameras: bool = True) -> Reading:
        """Return joints, grippers and pictures; a frame that did not come leaves the one before, with its time."""
        try:
            raw = self._robot.get_observation()
        except Exception as error:  # noqa: BLE001 - whatever a plugin raises
            raise DriverError(f"{self._robot} does not answer: {error}") from None
        now = time.monotonic()
        try:
            angles = np.array([float(raw[key]) for key in self._joints]) * _PER[self._words.unit]
            openings = [self._opening(float(raw[key])) for key in self._grippers]
        except (KeyError, TypeError, ValueError) as error:
            raise DriverError(f"{self._robot} says nothing of {error}; it says {', '.join(map(str, raw))}") from None
        state: dict[str, NDArray[np.float64]] = {}
        for arm, opening in zip(self._embodiment.arms, openings):
            state[arm.prefix + spec.State.ARM_JOINT_STATE], angles = angles[: arm.dof], angles[arm.dof :]
            state[arm.prefix + spec.State.EE_JOINT_STATE] = np.array([opening])
        if cameras:
            self._look(raw, now)
        return Reading(state, now, dict(self._pictures))

    def command(self, targets: Numbers) -> None:
        """Send joint targets in the robot's own units."""
        per, words = _PER[self._words.unit], self._words
        angles = np.concatenate([targets[arm.prefix + spec.State.ARM_JOINT_STATE] for arm in self._embodiment.arms])
        sent = {key: float(angle / per) for key, angle in zip(self._joints, angles)}
        for key, arm in zip(self._grippers, self._embodiment.arms):
            opening = float(targets[arm.prefix + spec.State.EE_JOINT_STATE][0])
            sent[key] = words.closed + opening * (words.open - words.closed)
        try:
            self._robot.send_action(sent)
        except Exception as error:  # noqa: BLE001 - whatever a plugin raises
            raise DriverError(f"{self._robot} takes no command: {error}") from None

    def close(self) -> None:
        """Disconnect; torque stays on."""
        if getattr(self._robot, "is_connected", True):
            self._robot.disconnect()

    def _opening(self, raw: float) -> float:
        share = (raw - self._words.closed) / (self._words.open - self._words.closed)
        return min(max(share, spec.GRIPPER_CLOSED), spec.GRIPPER_OPEN)

    def _look(self, raw: Mapping[str, Any], now: float) -> None:
        words = self._words.cameras or {key: key for key, value in raw.items() if np.ndim(value) == 3}
        for name, key in words.items():
            image = raw.get(key)
            if image is None:
                continue
            before = self._pictures.get(name)
            if before is None or before.image is not image:  # a camera that hangs hands out the same frame again
                self._pictures[name] = Picture(np.asarray(image, dtype=np.uint8), now)
