"""Safety between a policy and a robot: limits are kept and told; old, broken and wild actions are not executed.

    supervisor = Supervisor(get_embodiment("arx_x5"), "joint", frequency=25)
    supervisor.begin(first_observation)
    verdict = supervisor.check(action, age_s=now - time_of_the_observation_that_it_answers)
    robot.command(verdict.action)

`xpl.guard.GuardedEnv` does this in front of a task environment. An environment that keeps its limits itself, as a
simulation does that models them, needs no supervisor.
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
"""Control steps of motion at full speed that the first action may ask for. Farther away is no motion but a mistake:
other units, another order of joints, another robot."""

_SLACK = 1e-5  # rounding of float32 actions is no violation
_INSIDE = 0.999  # of a bound: what is nearer to it is looked at exactly
_FLOAT32 = np.dtype(np.float32)
_LEAST_NORM = 1e-3  # below it a quaternion has no direction


@dataclass(frozen=True)
class Correction:
    """One difference between what was commanded and what is executed.

    Attributes:
        kind: "joint_limit" (rad past it), "joint_speed" (rad/s past it), "gripper_range" (past 0 or 1),
            "quaternion_norm" (distance of its length from 1), "position_speed" (m/s past it), "rotation_speed" (rad/s
            past it), "action_age" (s past the limit), "far_first_action" (rad or m past what is allowed),
            "non_finite_action" (number of values).
        prefix: the arm, "" where it is the only one or all are meant.
        where: the joint, or the key of the action.
        amount: how far, the largest of the kind for this arm.
    """

    kind: str
    prefix: str
    where: str
    amount: float


@dataclass(frozen=True)
class Verdict:
    """What is to be executed.

    Attributes:
        action: the action step; the given one, untouched, if nothing had to be corrected.
        corrections: what had to be.
        held: why the pose is held instead of executing the action, a kind; None if it is executed.
        ends: whether the episode has to end for that reason.
    """

    action: Action
    corrections: tuple[Correction, ...] = ()
    held: str | None = None
    ends: bool = False


class Supervisor:
    """Keeps the commands of one robot within its limits, by the embodiment in the spec.

    What is not known of a robot (limits of a hand, joints without a published speed) bounds nothing, or is bounded by
    the speeds that the standard calls a jump. The pose that is held is the last one commanded, and before the first
    command the observed one.

    Args:
        embodiment: the robot.
        action_type: "joint" or "ee".
        frequency: control rate, Hz.
        max_age_s: seconds after which an action is too old to be executed; `AGE_STEPS` control steps by default.
        first_steps: control steps of motion that the first action may ask for; `math.inf` for no bound.

    Raises:
        ValueError: a number is not positive.
    """

    def __init__(
        self,
        embodiment: Embodiment,
        action_type: str,
        frequency: float,
        *,
        max_age_s: float | None = None,
        first_steps: float = FIRST_STEPS,
    ) -> None:
        if not (frequency > 0 and first_steps > 0 and (max_age_s is None or max_age_s > 0)):
            raise ValueError(f"expected positive numbers, got {frequency=}, {max_age_s=}, {first_steps=}")
        self._embodiment, self._action_type = embodiment, action_type
        self._dims = embodiment.dims(action_type)
        self.period = 1.0 / frequency
        self.max_age_s = AGE_STEPS * self.period if max_age_s is None else max_age_s
        self._first_steps = first_steps
        self._parts = _parts(embodiment, action_type, self.period)
        self._poses = [part for part in self._parts if isinstance(part, _Pose)]
        self._held: list[float] | None = None
        self._is_first = True

    def begin(self, obs: Observation) -> None:
        """Start an episode from the pose in its first observation.

        Raises:
            ObservationError: the state lacks what actions command.
        """
        self._held = pack_state(obs, self._embodiment, self._action_type).tolist()
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
        self._with_direction(flat.tolist())
        return flat

    def check(self, action: Action, age_s: float = 0.0) -> Verdict:
        """Judge one action step; what the verdict says is taken as executed.

        Args:
            action: the action step.
            age_s: time since the observation that it answers, without the steps of its chunk before it, s.

        Raises:
            ActionError: see `read`. Nothing is to be executed then.
            RuntimeError: no episode has begun.
        """
        if self._held is None:
            raise RuntimeError("no episode has begun: call begin with its first observation")
        values = self._numbers(action)
        if not all(map(math.isfinite, values)):
            bad = [
                key for key, part in unpack(values, self._embodiment, self._action_type).items() if not _finite(part)
            ]
            return self._hold(Correction(NON_FINITE, "", bad[0], float((~np.isfinite(values)).sum())), ends=True)
        if age_s > self.max_age_s:
            return self._hold(Correction(ACTION_AGE, "", "", age_s - self.max_age_s))
        if self._is_first:
            far = [part.excess(np.array(values), np.array(self._held), self._first_steps) for part in self._parts]
            past, where = max(far)
            if past > _SLACK:
                return self._hold(Correction(FAR_FIRST_ACTION, "", where, past), ends=True)
        self._is_first = False
        bent = [part for part in self._parts if not part.is_plain(values, self._held)]
        if not bent:
            self._held = values
            return Verdict(action)
        held, executed = np.array(self._held), np.array(values)
        corrections = tuple(found for part in bent for found in part.bound(executed, held) if found.amount > _SLACK)
        self._held = executed.tolist()
        if not corrections:
            return Verdict(action)
        return Verdict(unpack(executed, self._embodiment, self._action_type), corrections)

    def _numbers(self, action: Action) -> list[float]:
        """Return what `read` does, as plain numbers; what a server sends takes the short way."""
        values: list[float] = []
        for key, dim in self._dims.items():
            value = action.get(key)
            if type(value) is not np.ndarray or value.dtype is not _FLOAT32 or value.shape != (dim,):
                break
            values += value.tolist()
        else:
            if len(action) == len(self._dims):
                self._with_direction(values)
                return values
        exact: list[float] = self.read(action).tolist()
        return exact

    def _with_direction(self, values: list[float]) -> None:
        for part in self._poses:
            if part.norm(values) < _LEAST_NORM:
                raise ActionError(f"{part.key} must hold a unit quaternion, got {values[part.turn]}")

    def _hold(self, reason: Correction, *, ends: bool = False) -> Verdict:
        assert self._held is not None  # noqa: S101 - `check` has looked
        return Verdict(unpack(self._held, self._embodiment, self._action_type), (reason,), reason.kind, ends)


@dataclass(frozen=True)
class _Joints:
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

    def is_plain(self, wanted: list[float], held: list[float]) -> bool:
        """Tell by plain numbers that nothing has to be corrected, as in most control steps."""
        return all(
            lower <= value <= upper and abs(value - before) <= most
            for value, before, (lower, upper, most) in zip(wanted[self.columns], held[self.columns], self.plain)
        )

    def excess(self, flat: NDArray[np.float64], held: NDArray[np.float64], steps: float) -> tuple[float, str]:
        past = np.abs(flat[self.columns] - held[self.columns]) - steps * self.velocity * self.period
        return _worst(past, self.names)

    def bound(self, flat: NDArray[np.float64], held: NDArray[np.float64]) -> list[Correction]:
        wanted, before, most = flat[self.columns].copy(), held[self.columns], self.velocity * self.period
        allowed = np.clip(wanted, self.lower, self.upper)
        bounded = before + np.clip(allowed - before, -most, most)
        flat[self.columns] = bounded
        past, where = _worst(np.abs(wanted - allowed), self.names)
        fast, place = _worst(np.abs(allowed - bounded), self.names)
        return [
            Correction(JOINT_LIMIT, self.prefix, where, past),
            Correction(JOINT_SPEED, self.prefix, place, fast / self.period if fast > _SLACK else 0.0),
        ]


@dataclass(frozen=True)
class _Pose:
    """Flange pose of one arm, within the speeds that the standard calls a jump; columns of the flat action."""

    prefix: str
    key: str
    place: slice
    turn: slice
    period: float
    plain: tuple[float, float]
    """Square of a little less than its way of one period, and the cosine of half of a little less than its turn."""

    def norm(self, values: list[float]) -> float:
        """Return the length of the quaternion; NaN stays NaN."""
        w, x, y, z = values[self.turn]
        return math.sqrt(w * w + x * x + y * y + z * z)

    def excess(self, flat: NDArray[np.float64], held: NDArray[np.float64], steps: float) -> tuple[float, str]:
        moved, turned = self._distance(flat, held)
        reach, angle = spec.POSITION_SPEED * self.period, spec.ROTATION_SPEED * self.period
        return max(moved - steps * reach, turned - steps * angle), self.key

    def bound(self, flat: NDArray[np.float64], held: NDArray[np.float64]) -> list[Correction]:
        off = abs(self.norm(flat.tolist()) - 1.0)
        if off > spec.QUATERNION_TOLERANCE:
            flat[self.turn] = rotation.normalise(flat[self.turn])
        moved, turned = self._distance(flat, held)
        far = moved - spec.POSITION_SPEED * self.period
        wide = turned - spec.ROTATION_SPEED * self.period
        if far > _SLACK:
            before = held[self.place]
            flat[self.place] = before + (flat[self.place] - before) * (1.0 - far / moved)
        if wide > _SLACK:
            flat[self.turn] = rotation.slerp(held[self.turn], flat[self.turn], 1.0 - wide / turned)
        return [
            Correction(QUATERNION_NORM, self.prefix, self.key, off if off > spec.QUATERNION_TOLERANCE else 0.0),
            Correction(POSITION_SPEED, self.prefix, self.key, far / self.period if far > _SLACK else 0.0),
            Correction(ROTATION_SPEED, self.prefix, self.key, wide / self.period if wide > _SLACK else 0.0),
        ]

    def is_plain(self, wanted: list[float], held: list[float]) -> bool:
        """Tell by few numbers that a pose needs no correction: most do not, and this is asked in every control step.

        A little inside of the bounds, where the exact way could not tell otherwise.
        """
        (x, y, z), (w, i, j, k) = wanted[self.place], wanted[self.turn]
        (a, b, c), (p, q, r, s) = held[self.place], held[self.turn]
        reach, least = self.plain
        moved = (x - a) * (x - a) + (y - b) * (y - b) + (z - c) * (z - c)
        norm = self.norm(wanted)
        return (
            moved <= reach
            and abs(norm - 1.0) <= spec.QUATERNION_TOLERANCE
            and abs(w * p + i * q + j * r + k * s) >= least * norm * self.norm(held)
        )

    def _distance(self, flat: NDArray[np.float64], held: NDArray[np.float64]) -> tuple[float, float]:
        moved = float(np.linalg.norm(flat[self.place] - held[self.place]))
        return moved, float(rotation.angle_between(held[self.turn], rotation.normalise(flat[self.turn])))


@dataclass(frozen=True)
class _Gripper:
    """A parallel gripper within its range. Its fingers move at their own speed: asking for more is how it is used."""

    prefix: str
    key: str
    column: int

    def excess(self, _flat: NDArray[np.float64], _held: NDArray[np.float64], _steps: float) -> tuple[float, str]:
        return 0.0, self.key

    def is_plain(self, wanted: list[float], _held: list[float]) -> bool:
        return bool(spec.GRIPPER_CLOSED <= wanted[self.column] <= spec.GRIPPER_OPEN)

    def bound(self, flat: NDArray[np.float64], _held: NDArray[np.float64]) -> list[Correction]:
        wanted = float(flat[self.column])
        flat[self.column] = min(max(wanted, spec.GRIPPER_CLOSED), spec.GRIPPER_OPEN)
        return [Correction(GRIPPER_RANGE, self.prefix, self.key, abs(wanted - float(flat[self.column])))]


def _parts(embodiment: Embodiment, action_type: str, period: float) -> list[_Joints | _Pose | _Gripper]:
    arm_key, ee_key = spec.ACTION_KEYS[action_type]
    parts: list[_Joints | _Pose | _Gripper] = []
    at = 0
    for arm in embodiment.arms:
        if arm_key == spec.State.EE_POSE:
            split, end = at + spec.POSITION_DIM, at + spec.POSE_DIM
            parts.append(_pose(arm.prefix, slice(at, split), slice(split, end), period))
        else:
            end = at + arm.dof
            parts.append(_joints(arm, slice(at, end), period))
        if arm.gripper == "parallel_gripper":
            parts.append(_Gripper(arm.prefix, arm.prefix + ee_key, end))
        at = end + arm.ee_dim
    return parts


def _pose(prefix: str, place: slice, turn: slice, period: float) -> _Pose:
    reach, angle = _INSIDE * spec.POSITION_SPEED * period, _INSIDE * spec.ROTATION_SPEED * period
    least = math.cos(angle / 2) if angle < math.pi else 0.0  # no turn is longer
    return _Pose(prefix, prefix + spec.State.EE_POSE, place, turn, period, (reach * reach, least))


def _joints(arm: Arm, columns: slice, period: float) -> _Joints:
    names = arm.joint_names or tuple(f"joint{index + 1}" for index in range(arm.dof))
    lower = np.full(arm.dof, -math.inf) if arm.lower is None else arm.lower
    upper = np.full(arm.dof, math.inf) if arm.upper is None else arm.upper
    velocity = np.full(arm.dof, spec.JOINT_SPEED) if arm.velocity is None else arm.velocity
    return _Joints(
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
