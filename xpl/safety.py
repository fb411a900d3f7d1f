"""Safety supervisor between a policy and a robot: enforces limits; old, invalid and distant actions are not executed.

    supervisor = Supervisor(get_embodiment("arx_x5"), "joint", frequency=25)
    supervisor.begin(first_observation)
    verdict = supervisor.check(action, age_s=now - time_of_the_observation_that_it_answers)
    robot.command(verdict.action)

`xpl.guard.GuardedEnv` does this in front of an environment. An environment that enforces its limits itself needs no
supervisor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.action import ActionError, pack, unpack
from xpl.observation import pack_state

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl.contract import Action, Observation
    from xpl.embodiment import Arm, Embodiment

JOINT_LIMIT, JOINT_SPEED, GRIPPER_RANGE = "joint_limit", "joint_speed", "gripper_range"
QUATERNION_NORM, POSITION_SPEED, ROTATION_SPEED = "quaternion_norm", "position_speed", "rotation_speed"
ACTION_AGE, FAR_FIRST_ACTION, NON_FINITE = "action_age", "far_first_action", "non_finite_action"

AGE_STEPS = 10.0
"""Control steps after which an action is too old: long enough for a large model far away, short enough that the scene
is still the one it was meant for (0.4 s at 25 Hz)."""
FIRST_STEPS = 3.0
"""Most control steps of motion at full speed to the first action. A farther one is an error: other units, another
order of joints, another robot."""

_SLACK = 1e-5  # rounding of float32 actions is no violation
_INSIDE = 0.999  # of a bound: a value nearer to it is checked exactly
_FLOAT32 = np.dtype(np.float32)
_LEAST_NORM = 1e-3  # below it a quaternion has no direction


@dataclass(frozen=True)
class Correction:
    """One difference between the commanded and the executed action.

    Attributes:
        kind: "joint_limit" (rad past it), "joint_speed" (rad/s past it), "gripper_range" (past 0 or 1),
            "quaternion_norm" (distance of its length from 1), "position_speed" (m/s past it), "rotation_speed" (rad/s
            past it), "action_age" (s past the limit), "far_first_action" (rad or m past what is allowed),
            "non_finite_action" (number of values).
        prefix: prefix of the arm, "" for the only one or for all.
        where: the joint, or the key of the action.
        amount: largest amount of the kind for this arm.
    """

    kind: str
    prefix: str
    where: str
    amount: float


@dataclass(frozen=True)
class SafetyVerdict:
    """Result of a check: the action to execute.

    Attributes:
        action: the action step; the same object if nothing was corrected.
        corrections: the corrections.
        hold_reason: kind of the correction for which the pose is held; None if the action is executed.
        ends: whether the episode must end for that reason.
    """

    action: Action
    corrections: tuple[Correction, ...] = ()
    hold_reason: str | None = None
    ends: bool = False


class Supervisor:
    """Keeps the commands of one robot within the limits of its embodiment.

    Unknown limits (of a hand, joints without a published speed) are not enforced, or the standard's speed limits apply.
    A hold is at the last commanded pose, before the first command at the observed one.

    Args:
        embodiment: the robot.
        action_type: "joint" or "ee".
        frequency: control rate, Hz.
        max_age_s: seconds after which an action is too old to be executed; `AGE_STEPS` control steps by default.
        first_steps: most control steps of motion at full speed to the first action; `math.inf` for no limit.
        fastest: multiple of these speeds that a command may have; `math.inf` for no limit.

    Raises:
        ValueError: a number is not positive.
    """

    def __init__(  # noqa: PLR0913 - each option is a limit of its own
        self,
        embodiment: Embodiment,
        action_type: str,
        frequency: float,
        *,
        max_age_s: float | None = None,
        first_steps: float = FIRST_STEPS,
        fastest: float = 1.0,
    ) -> None:
        if not (frequency > 0 and first_steps > 0 and fastest > 0 and (max_age_s is None or max_age_s > 0)):
            raise ValueError(f"expected positive numbers, got {frequency=}, {max_age_s=}, {first_steps=}, {fastest=}")
        self._embodiment, self._action_type = embodiment, action_type
        self._dims = embodiment.dims(action_type)
        self.period = 1.0 / frequency
        self.max_age_s = AGE_STEPS * self.period if max_age_s is None else max_age_s
        self._first_steps = first_steps
        self._parts = _parts(embodiment, action_type, self.period * fastest)
        self._poses = [part for part in self._parts if isinstance(part, _PoseBounds)]
        self._last_command: list[float] | None = None
        self._is_first = True

    def begin(self, obs: Observation) -> None:
        """Start an episode from the pose in its first observation.

        Raises:
            ObservationError: the state lacks a field of the action type.
        """
        self._last_command = pack_state(obs, self._embodiment, self._action_type).tolist()
        self._is_first = True

    def read(self, action: Action) -> NDArray[np.float64]:
        """Return an action step as a vector (D,), rounded to float32; values may be NaN or infinite.

        Raises:
            ActionError: keys or dimensions are wrong, or a quaternion has no direction.
        """
        extra = [str(key) for key in action if key not in self._dims]
        if extra:
            raise ActionError(f"the action has {', '.join(extra)}; send exactly {', '.join(self._dims)}")
        flat = pack(action, self._embodiment, self._action_type).astype(np.float64)
        self._check_quaternions(flat.tolist())
        return flat

    def check(self, action: Action, age_s: float = 0.0) -> SafetyVerdict:
        """Check one action step; the action of the verdict counts as executed.

        Args:
            action: the action step.
            age_s: time since the observation of its inference, minus the earlier steps of its chunk, s.

        Returns:
            The action to execute, and its corrections.

        Raises:
            ActionError: see `read`. Nothing may be executed.
            RuntimeError: no episode has begun.
        """
        if self._last_command is None:
            raise RuntimeError("no episode has begun: call begin with its first observation")
        values = self._values(action)
        if not all(map(math.isfinite, values)):
            bad = [
                key for key, part in unpack(values, self._embodiment, self._action_type).items() if not _finite(part)
            ]
            return self._hold(Correction(NON_FINITE, "", bad[0], float((~np.isfinite(values)).sum())), ends=True)
        if age_s > self.max_age_s:
            return self._hold(Correction(ACTION_AGE, "", "", age_s - self.max_age_s))
        if self._is_first:
            far = [
                part.excess(np.array(values), np.array(self._last_command), self._first_steps) for part in self._parts
            ]
            past, where = max(far)
            if past > _SLACK:
                return self._hold(Correction(FAR_FIRST_ACTION, "", where, past), ends=True)
        self._is_first = False
        bent = [part for part in self._parts if not part.is_plain(values, self._last_command)]
        if not bent:
            self._last_command = values
            return SafetyVerdict(action)
        last, executed = np.array(self._last_command), np.array(values)
        corrections = tuple(found for part in bent for found in part.bound(executed, last) if found.amount > _SLACK)
        self._last_command = executed.tolist()
        if not corrections:
            return SafetyVerdict(action)
        return SafetyVerdict(unpack(executed, self._embodiment, self._action_type), corrections)

    def _values(self, action: Action) -> list[float]:
        """Return the values of `read` as a list; float32 arrays take a fast path."""
        values: list[float] = []
        for key, dim in self._dims.items():
            value = action.get(key)
            if type(value) is not np.ndarray or value.dtype is not _FLOAT32 or value.shape != (dim,):
                break
            values += value.tolist()
        else:
            if len(action) == len(self._dims):
                self._check_quaternions(values)
                return values
        exact: list[float] = self.read(action).tolist()
        return exact

    def _check_quaternions(self, values: list[float]) -> None:
        for part in self._poses:
            if part.norm(values) < _LEAST_NORM:
                raise ActionError(f"{part.key} must hold a unit quaternion, got {values[part.turn]}")

    def _hold(self, reason: Correction, *, ends: bool = False) -> SafetyVerdict:
        assert self._last_command is not None  # noqa: S101 - `check` has looked
        return SafetyVerdict(
            unpack(self._last_command, self._embodiment, self._action_type), (reason,), reason.kind, ends
        )


@dataclass(frozen=True)
class _JointBounds:
    """Joint angles of one arm, within limits and speeds; columns of the flat action."""

    prefix: str
    columns: slice
    names: tuple[str, ...]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    velocity: NDArray[np.float64]
    period: float
    plain: Sequence[tuple[float, float, float]]
    """Of each joint its limits, and a little less than its way of one period."""

    def is_plain(self, target: list[float], last: list[float]) -> bool:
        """Tell by plain numbers that nothing has to be corrected, as in most control steps."""
        return all(
            lower <= value <= upper and abs(value - before) <= most
            for value, before, (lower, upper, most) in zip(target[self.columns], last[self.columns], self.plain)
        )

    def excess(self, flat: NDArray[np.float64], last: NDArray[np.float64], steps: float) -> tuple[float, str]:
        past = np.abs(flat[self.columns] - last[self.columns]) - steps * self.velocity * self.period
        return _worst(past, self.names)

    def bound(self, flat: NDArray[np.float64], last: NDArray[np.float64]) -> list[Correction]:
        target, before, most = flat[self.columns].copy(), last[self.columns], self.velocity * self.period
        allowed = np.clip(target, self.lower, self.upper)
        bounded = before + np.clip(allowed - before, -most, most)
        flat[self.columns] = bounded
        past, where = _worst(np.abs(target - allowed), self.names)
        fast, fastest = _worst(np.abs(allowed - bounded), self.names)
        return [
            Correction(JOINT_LIMIT, self.prefix, where, past),
            Correction(JOINT_SPEED, self.prefix, fastest, fast / self.period if fast > _SLACK else 0.0),
        ]


@dataclass(frozen=True)
class _PoseBounds:
    """Flange pose of one arm, within the speeds that the standard calls a jump; columns of the flat action."""

    prefix: str
    key: str
    position: slice
    turn: slice
    period: float
    plain: tuple[float, float]
    """Square of a little less than its way of one period, and the cosine of half of a little less than its turn."""

    def norm(self, values: list[float]) -> float:
        """Return the length of the quaternion; NaN stays NaN."""
        w, x, y, z = values[self.turn]
        return math.sqrt(w * w + x * x + y * y + z * z)

    def excess(self, flat: NDArray[np.float64], last: NDArray[np.float64], steps: float) -> tuple[float, str]:
        moved, turned = self._distance(flat, last)
        reach, angle = spec.POSITION_SPEED * self.period, spec.ROTATION_SPEED * self.period
        return max(moved - steps * reach, turned - steps * angle), self.key

    def bound(self, flat: NDArray[np.float64], last: NDArray[np.float64]) -> list[Correction]:
        off = abs(self.norm(flat.tolist()) - 1.0)
        if off > spec.QUATERNION_TOLERANCE:
            flat[self.turn] = rotation.normalise(flat[self.turn])
        moved, turned = self._distance(flat, last)
        far = moved - spec.POSITION_SPEED * self.period
        wide = turned - spec.ROTATION_SPEED * self.period
        if far > _SLACK:
            before = last[self.position]
            flat[self.position] = before + (flat[self.position] - before) * (1.0 - far / moved)
        if wide > _SLACK:
            flat[self.turn] = rotation.slerp(last[self.turn], flat[self.turn], 1.0 - wide / turned)
        return [
            Correction(QUATERNION_NORM, self.prefix, self.key, off if off > spec.QUATERNION_TOLERANCE else 0.0),
            Correction(POSITION_SPEED, self.prefix, self.key, far / self.period if far > _SLACK else 0.0),
            Correction(ROTATION_SPEED, self.prefix, self.key, wide / self.period if wide > _SLACK else 0.0),
        ]

    def is_plain(self, target: list[float], last: list[float]) -> bool:
        """Return by a fast check whether a pose needs no correction, as in most control steps.

        A little inside of the bounds, where the exact way could not tell otherwise.
        """
        (x, y, z), (w, i, j, k) = target[self.position], target[self.turn]
        (a, b, c), (p, q, r, s) = last[self.position], last[self.turn]
        reach, least = self.plain
        moved = (x - a) * (x - a) + (y - b) * (y - b) + (z - c) * (z - c)
        norm = self.norm(target)
        return (
            moved <= reach
            and abs(norm - 1.0) <= spec.QUATERNION_TOLERANCE
            and abs(w * p + i * q + j * r + k * s) >= least * norm * self.norm(last)
        )

    def _distance(self, flat: NDArray[np.float64], last: NDArray[np.float64]) -> tuple[float, float]:
        moved = float(np.linalg.norm(flat[self.position] - last[self.position]))
        return moved, float(rotation.angle_between(last[self.turn], rotation.normalise(flat[self.turn])))


@dataclass(frozen=True)
class _GripperBounds:
    """A parallel gripper within its range. Its fingers move at their own speed: asking for more is how it is used."""

    prefix: str
    key: str
    column: int

    def excess(self, _flat: NDArray[np.float64], _held: NDArray[np.float64], _steps: float) -> tuple[float, str]:
        return 0.0, self.key

    def is_plain(self, target: list[float], _held: list[float]) -> bool:
        return bool(spec.GRIPPER_CLOSED <= target[self.column] <= spec.GRIPPER_OPEN)

    def bound(self, flat: NDArray[np.float64], _held: NDArray[np.float64]) -> list[Correction]:
        target = float(flat[self.column])
        flat[self.column] = min(max(target, spec.GRIPPER_CLOSED), spec.GRIPPER_OPEN)
        return [Correction(GRIPPER_RANGE, self.prefix, self.key, abs(target - float(flat[self.column])))]


def _parts(
    embodiment: Embodiment, action_type: str, period: float
) -> list[_JointBounds | _PoseBounds | _GripperBounds]:
    arm_key, ee_key = spec.ACTION_KEYS[action_type]
    parts: list[_JointBounds | _PoseBounds | _GripperBounds] = []
    at = 0
    for arm in embodiment.arms:
        if arm_key == spec.State.EE_POSE:
            split, end = at + spec.POSITION_DIM, at + spec.POSE_DIM
            parts.append(_pose(arm.prefix, slice(at, split), slice(split, end), period))
        else:
            end = at + arm.dof
            parts.append(_joints(arm, slice(at, end), period))
        if arm.gripper == "parallel_gripper":
            parts.append(_GripperBounds(arm.prefix, arm.prefix + ee_key, end))
        at = end + arm.ee_dim
    return parts


def _pose(prefix: str, position: slice, turn: slice, period: float) -> _PoseBounds:
    reach, angle = _INSIDE * spec.POSITION_SPEED * period, _INSIDE * spec.ROTATION_SPEED * period
    least = math.cos(angle / 2) if angle < math.pi else 0.0  # no turn is longer
    return _PoseBounds(prefix, prefix + spec.State.EE_POSE, position, turn, period, (reach * reach, least))


def _joints(arm: Arm, columns: slice, period: float) -> _JointBounds:
    names = arm.joint_names or tuple(f"joint{index + 1}" for index in range(arm.dof))
    lower = np.full(arm.dof, -math.inf) if arm.lower is None else arm.lower
    upper = np.full(arm.dof, math.inf) if arm.upper is None else arm.upper
    velocity = np.full(arm.dof, spec.JOINT_SPEED) if arm.velocity is None else arm.velocity
    return _JointBounds(
        prefix=arm.prefix,
        columns=columns,
        names=tuple(arm.prefix + name for name in names),
        lower=lower,
        upper=upper,
        velocity=velocity,
        period=period,
        plain=list(zip(lower.tolist(), upper.tolist(), (_INSIDE * velocity * period).tolist())),
    )


def _worst(amounts: NDArray[np.float64], names: tuple[str, ...]) -> tuple[float, str]:
    index = int(amounts.argmax())
    return float(amounts[index]), names[index]


def _finite(values: np.ndarray) -> bool:
    return bool(np.isfinite(values).all())
