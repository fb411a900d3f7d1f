"""From an action to position targets: limits are kept, and every time they had to be is counted and reported."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.action import ActionError, pack
from xpl.kinematics import Chain
from xpl.poses import invert
from xpl.safety import GRIPPER_RANGE, JOINT_LIMIT, JOINT_SPEED, QUATERNION_NORM

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from xpl.embodiment import Embodiment

UNREACHABLE, ROTATION_ERROR = "unreachable", "rotation_error"

Corrections = dict[str, dict[str, float]]
"""How commands differed from what was executed in one control step: by arm prefix, the largest amount of each kind.

An arm whose command was executed as given does not appear. Kinds are "joint_limit" (rad past it), "joint_speed" (rad/s
past it), "gripper_range" (past 0 or 1), "quaternion_norm" (distance of its length from 1) and "unreachable" (m, how far
the nearest reachable flange position is off), which "rotation_error" (rad, to the target's rotation) accompanies.
"""

_SLACK = 1e-5  # rounding of float32 actions is no violation
_LEAST_NORM = 1e-3  # below it a quaternion has no direction


class ActionReader:
    """Reads action steps into flat vectors.

    Args:
        embodiment: the robot.
        action_type: "joint" or "ee".
    """

    def __init__(self, embodiment: Embodiment, action_type: str) -> None:
        self._embodiment, self._action_type = embodiment, action_type
        self._dims = embodiment.dims(action_type)
        self._shapes = [(key, (dim,)) for key, dim in self._dims.items()]

    def read(self, action: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the action as a vector (D,), rounded to float32 as on the wire; values may be NaN or infinite.

        Raises:
            ActionError: keys or dimensions are not those of embodiment and action type.
        """
        if len(action) == len(self._shapes):
            values: list[Any] = [action.get(key) for key, _ in self._shapes]
            if all(
                type(value) is np.ndarray and value.dtype == np.float32 and value.shape == shape
                for value, (_, shape) in zip(values, self._shapes, strict=True)
            ):
                return np.concatenate(values, dtype=np.float64)
        return self._read_carefully(action)

    def _read_carefully(self, action: Mapping[str, Any]) -> NDArray[np.float64]:
        """Read what is not plainly right: lists and other numbers are, after all; of the rest, say what is wrong."""
        extra = [key for key in action if key not in self._dims]
        if extra:
            raise ActionError(
                f"the action has {', '.join(map(str, extra))}, which {self._action_type} control of "
                f"{self._embodiment.name} does not know: send exactly {', '.join(self._dims)}"
            )
        return pack(action, self._embodiment, self._action_type).astype(np.float64)


@dataclass(frozen=True)
class _Part:
    """One arm's share of an action and of the targets."""

    prefix: str
    command: slice  # joints or pose, in the action
    opening: int  # in the action
    joints: slice  # in the targets
    gripper: int  # in the targets
    # A pose in the world, as a column, times `turn` (7, 7), plus `shift` (7,), is the pose in the arm's base.
    turn: NDArray[np.float64]
    shift: NDArray[np.float64]


class Control:
    """Executes the actions of all arms, within their limits.

    Args:
        embodiment: the robot.
        action_type: "joint" or "ee".
        bases: pose (7,) of each arm's base in the world.
        starts: joint angles (dof,) of each arm at the beginning, rad; grippers are open.
        period: length of a control step, s.

    Attributes:
        targets: (D,) in force, as in a flat joint action: an arm's joint angles (rad), its gripper (0 closed, 1 open).
    """

    def __init__(
        self,
        embodiment: Embodiment,
        action_type: str,
        bases: Sequence[NDArray[np.float64]],
        starts: Sequence[NDArray[np.float64]],
        period: float,
    ) -> None:
        arm_key, _ = spec.ACTION_KEYS[action_type]
        self.targets = np.concatenate([[*start, spec.GRIPPER_OPEN] for start in starts])
        self._embodiment, self._period = embodiment, period
        self._posed = arm_key == spec.State.EE_POSE
        self._pose_key = arm_key
        self._chain = chain = Chain.from_embodiment(embodiment.data)
        self._parts = _parts(embodiment, action_type, bases)
        effector, count = embodiment.data["end_effector"], len(embodiment.arms)
        # The fingers move at their own speed; asking for more is how a gripper is used, not a violation.
        speed = math.inf if effector["velocity"] is None else effector["velocity"] / effector["finger_range"][1]
        self._lower = np.tile([*chain.lower, spec.GRIPPER_CLOSED], count)
        self._upper = np.tile([*chain.upper, spec.GRIPPER_OPEN], count)
        self._largest_change = np.tile([*chain.velocity, speed], count) * period
        self._least_change = -self._largest_change
        self._speed_counts = np.tile([*np.ones(chain.dof), 0.0], count)

    def execute(self, action: NDArray[np.float64]) -> Corrections:
        """Set the targets from one flat, finite action (D,); return what had to be corrected.

        A pose out of reach is approached as near as possible.

        Raises:
            ActionError: a quaternion has no direction. No target has changed then.
        """
        corrections: Corrections = {}
        target = self._joints_for(action, corrections) if self._posed else action
        allowed = np.minimum(np.maximum(target, self._lower), self._upper)
        change = allowed - self.targets
        bounded = np.minimum(np.maximum(change, self._least_change), self._largest_change)
        self.targets = self.targets + bounded
        off = target - self.targets
        if off.dot(off) > _SLACK * _SLACK:
            past_speed = np.abs(change - bounded) * self._speed_counts
            self._report(np.abs(target - allowed), past_speed, corrections)
        return corrections

    def _joints_for(self, action: NDArray[np.float64], corrections: Corrections) -> NDArray[np.float64]:
        """Return the targets (D,) that bring every flange to its pose in the world."""
        norms = [self._norm(action, part) for part in self._parts]
        wanted = np.empty_like(self.targets)
        for part, norm in zip(self._parts, norms, strict=True):
            found: dict[str, float] = {}
            if abs(norm - 1.0) > spec.QUATERNION_TOLERANCE:
                found[QUATERNION_NORM] = abs(norm - 1.0)
            target = action[part.command].copy()
            target[spec.POSITION_DIM :] /= norm
            # No matrix product: its last bits would depend on the machine's BLAS.
            local = (part.turn * target).sum(axis=1) + part.shift
            solution = self._chain.solve(local, self.targets[part.joints])
            if not solution.converged:
                found.update({UNREACHABLE: solution.position_error, ROTATION_ERROR: solution.rotation_error})
            wanted[part.joints], wanted[part.gripper] = solution.joints, action[part.opening]
            if found:
                corrections[part.prefix] = found
        return wanted

    def _norm(self, action: NDArray[np.float64], part: _Part) -> float:
        """Return the length of a quaternion that has a direction."""
        quaternion = action[part.command][spec.POSITION_DIM :].tolist()
        norm = math.sqrt(sum(value * value for value in quaternion))
        if norm < _LEAST_NORM:
            raise ActionError(f"{part.prefix}{self._pose_key} must hold a unit quaternion, got {quaternion}")
        return norm

    def _report(
        self, past_limit: NDArray[np.float64], past_speed: NDArray[np.float64], corrections: Corrections
    ) -> None:
        for part in self._parts:
            amounts = {
                JOINT_LIMIT: float(past_limit[part.joints].max()),
                JOINT_SPEED: float(past_speed[part.joints].max()),
                GRIPPER_RANGE: float(past_limit[part.gripper]),
            }
            found = {kind: amount for kind, amount in amounts.items() if amount > _SLACK}
            if JOINT_SPEED in found:
                found[JOINT_SPEED] /= self._period
            if found:
                corrections.setdefault(part.prefix, {}).update(found)


def _parts(embodiment: Embodiment, action_type: str, bases: Sequence[NDArray[np.float64]]) -> list[_Part]:
    arm_key, _ = spec.ACTION_KEYS[action_type]
    dims = embodiment.dims(action_type)
    parts, at, start = [], 0, 0
    for arm, base in zip(embodiment.arms, bases, strict=True):
        dim = dims[arm.prefix + arm_key]
        turn, shift = _into(base)
        parts.append(
            _Part(
                prefix=arm.prefix,
                command=slice(at, at + dim),
                opening=at + dim,
                joints=slice(start, start + arm.dof),
                gripper=start + arm.dof,
                turn=turn,
                shift=shift,
            )
        )
        at, start = at + dim + arm.ee_dim, start + arm.dof + arm.ee_dim
    return parts


def _into(base: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the map (7, 7) and the offset (7,) that take a pose in the world to the frame `base`."""
    split, inverse = spec.POSITION_DIM, invert(base)
    turn, shift = np.zeros((spec.POSE_DIM, spec.POSE_DIM)), np.zeros(spec.POSE_DIM)
    turn[:split, :split] = rotation.to_matrix(inverse[split:])
    # Multiplying quaternions is linear in the second one: its columns are the products with the units.
    turn[split:, split:] = rotation.multiply(inverse[split:], np.eye(spec.POSE_DIM - split)).T
    shift[:split] = inverse[:split]
    return turn, shift
