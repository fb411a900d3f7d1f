"""Kinematics of a serial arm: forward, Jacobian, and inverse by damped least squares, from the spec's joint data.

Poses are ``[x, y, z, qw, qx, qy, qz]`` (m, unit quaternion), joint angles are rad. A chain lives in the frame of its
own base; `xpl.poses` moves poses between frames.

The inner loops work on Python floats. At six or seven joints that is as fast as arrays, whose cost here is the call and
not the arithmetic, and the result is the same on every machine because no BLAS or LAPACK kernel takes part.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import robots, rotation
from xpl.poses import compose, invert, pose

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from xpl.contract import Entry

__all__ = ["Chain", "KinematicsError", "Solution"]

_Vector = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]

# One radian counts as much as this many metres: about the distance from a wrist to its fingertips.
_METRES_PER_RADIAN = 0.2
# Damping grows with the squared error (Sugihara 2011), which keeps far and singular targets tame and leaves
# Gauss-Newton's quadratic convergence near the solution.
_DAMPING = 1e-2
_DAMPING_FLOOR = 1e-10
_LARGEST_STEP = 0.5  # rad in one iteration: beyond it the linearisation means nothing
_LEAST_PROGRESS = 1e-3  # relative; less than this over a few iterations is a target out of reach
_PATIENCE = 5
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


class KinematicsError(ValueError):
    """An embodiment has no kinematics, or joint angles or a pose have the wrong shape or values."""


@dataclass(frozen=True)
class Solution:
    """Result of inverse kinematics.

    Attributes:
        joints: (dof,) float64, rad, always within the limits.
        converged: whether both errors are within the tolerances. If not, `joints` is the nearest configuration
            found, and the errors are its distance from the target.
        position_error: distance to the target, m.
        rotation_error: angle to the target, rad.
        iterations: steps taken.
    """

    joints: NDArray[np.float64]
    converged: bool
    position_error: float
    rotation_error: float
    iterations: int


@dataclass(frozen=True)
class _Joint:
    """A revolute joint: its frame in the frame of the joint before, and its turn as ``cos * still + sin * turned``."""

    offset: _Vector
    axis: _Vector
    still: _Quaternion
    turned: _Quaternion


@dataclass(frozen=True)
class Chain:
    """A serial chain of revolute joints from the arm's base to its flange.

    Attributes:
        names: names of the joints.
        lower, upper: deployed limits, (dof,) float64, rad.
        velocity: speed limits, (dof,) float64, rad/s; infinite where none is known.
        home: home pose, (dof,) float64, rad, or None.
        tcp_offset: pose (7,) of the point between the fingertips in the flange, or None.
    """

    names: tuple[str, ...]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    velocity: NDArray[np.float64]
    home: NDArray[np.float64] | None
    tcp_offset: NDArray[np.float64] | None
    _joints: tuple[_Joint, ...]

    @classmethod
    def from_embodiment(cls, data: Mapping[str, Any]) -> Chain:
        """Build the chain of an embodiment's arm from its entry in the spec (`Embodiment.data`).

        Raises:
            KinematicsError: the entry holds dimensions only.
        """
        entries, home = data["arm"]["joints"], data["arm"]["home"]
        if not robots.has_frames(data):
            raise KinematicsError(
                f"embodiment {data['name']!r} has no joint frames, so there is no kinematics for it; "
                f"with kinematics are {', '.join(_with_kinematics())}"
            )
        limits = np.array([entry["limits"] for entry in entries], dtype=np.float64)
        speed = [math.inf if entry.get("velocity") is None else entry["velocity"] for entry in entries]
        tcp = data["end_effector"].get("tcp")
        return cls(
            names=tuple(entry["name"] for entry in entries),
            lower=limits[:, 0],
            upper=limits[:, 1],
            velocity=np.array(speed, dtype=np.float64),
            home=None if home is None else np.array(home, dtype=np.float64),
            tcp_offset=None if tcp is None else pose(tcp["xyz"], rotation.from_rpy(tcp["rpy"])),
            _joints=tuple(_joint(entry) for entry in entries),
        )

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self._joints)

    def flange(self, joints: ArrayLike) -> NDArray[np.float64]:
        """Return the pose (7,) of the flange in the base for joint angles (dof,)."""
        _, _, position, turn = self._forward(self._angles(joints))
        return np.array(position + turn)

    def points(self, joints: ArrayLike) -> NDArray[np.float64]:
        """Return the positions of joints and flange in the base, (dof + 1, 3) m, for joint angles (dof,)."""
        origins, _, position, _ = self._forward(self._angles(joints))
        return np.array([*origins, position])

    def tcp(self, joints: ArrayLike) -> NDArray[np.float64]:
        """Return the pose (7,) of the point between the fingertips in the base for joint angles (dof,)."""
        return self.tcp_from_flange(self.flange(joints))

    def tcp_from_flange(self, flange: ArrayLike) -> NDArray[np.float64]:
        """Return the tcp pose (..., 7) that goes with flange poses (..., 7) given in any one frame."""
        return compose(flange, self._tcp())

    def flange_from_tcp(self, tcp: ArrayLike) -> NDArray[np.float64]:
        """Return the flange pose (..., 7) that goes with tcp poses (..., 7) given in any one frame."""
        return compose(tcp, invert(self._tcp()))

    def solve(
        self,
        flange: ArrayLike,
        start: ArrayLike,
        *,
        position_tolerance: float = 1e-5,
        rotation_tolerance: float = 1e-4,
        max_iterations: int = 40,
    ) -> Solution:
        """Find joint angles that put the flange at a pose, searching from `start` only, so that motion is continuous.

        Damped least squares in joint space; a joint that would leave its limits stays at the limit and the others
        make up for it. A target that is out of reach gives the nearest configuration with ``converged`` false.

        Args:
            flange: target pose (7,) in the base.
            start: joint angles (dof,) to start from; near the solution two or three iterations suffice.
            position_tolerance: m.
            rotation_tolerance: rad.
            max_iterations: upper bound.

        Raises:
            KinematicsError: the target or the start has the wrong shape or is not finite.
        """
        values = _checked_pose(flange)
        target, goal = (values[0], values[1], values[2]), (values[3], values[4], values[5], values[6])
        limits = list(zip(self.lower.tolist(), self.upper.tolist()))
        angles = [min(max(angle, low), high) for angle, (low, high) in zip(self._angles(start), limits)]
        best, best_cost, best_errors = angles, math.inf, (math.inf, math.inf)
        stalled = iteration = 0
        for iteration in range(max_iterations + 1):
            origins, axes, position, turn = self._forward(angles)
            shift = (target[0] - position[0], target[1] - position[1], target[2] - position[2])
            twist = _rotation_error(goal, turn)
            errors = (_length(shift), _length(twist))
            cost = errors[0] ** 2 + (_METRES_PER_RADIAN * errors[1]) ** 2
            stalled = 0 if cost < (1.0 - _LEAST_PROGRESS) * best_cost else stalled + 1
            if cost < best_cost:
                best, best_cost, best_errors = angles, cost, errors
            if errors[0] <= position_tolerance and errors[1] <= rotation_tolerance:
                break
            if stalled >= _PATIENCE or iteration == max_iterations:
                break
            residual = (*shift, *(_METRES_PER_RADIAN * value for value in twist))
            columns = [_column(origin, axis, position, _METRES_PER_RADIAN) for origin, axis in zip(origins, axes)]
            angles = _step(columns, residual, angles, limits, _DAMPING * cost + _DAMPING_FLOOR)
        return Solution(
            joints=np.array(best),
            converged=best_errors[0] <= position_tolerance and best_errors[1] <= rotation_tolerance,
            position_error=best_errors[0],
            rotation_error=best_errors[1],
            iterations=iteration,
        )

    def search(self, flange: ArrayLike, start: ArrayLike, *, attempts: int = 8) -> Solution:
        """Find joint angles like `solve`, from further starting points until one converges.

        For planning, where a jump of configuration does not matter. The points are fixed (home, then a low-discrepancy
        sequence over the limits), so the result is deterministic.

        Args:
            flange: target pose (7,) in the base: m, unit quaternion, w first.
            start: joint angles (dof,) of the first attempt, rad.
            attempts: most further starting points.

        Returns:
            The first solution that converged, else the one with the least error.
        """
        best = self.solve(flange, start)
        for attempt in range(attempts):
            if best.converged:
                break
            other = self.solve(flange, self._starting_point(attempt), max_iterations=80)
            if other.converged or _cost(other) < _cost(best):
                best = other
        return best

    def _starting_point(self, attempt: int) -> NDArray[np.float64]:
        if attempt == 0 and self.home is not None:
            return self.home
        fraction = (0.5 + attempt * np.power(_GOLDEN, np.arange(1, self.dof + 1))) % 1.0
        point: NDArray[np.float64] = self.lower + fraction * (self.upper - self.lower)
        return point

    def _forward(self, angles: Sequence[float]) -> tuple[list[_Vector], list[_Vector], _Vector, _Quaternion]:
        """Return each joint's origin and axis in the base, and the flange's position and rotation."""
        origins, axes = [], []
        position: _Vector = (0.0, 0.0, 0.0)
        turn: _Quaternion = (1.0, 0.0, 0.0, 0.0)
        for joint, angle in zip(self._joints, angles):
            dx, dy, dz = _rotate(turn, joint.offset)
            position = (position[0] + dx, position[1] + dy, position[2] + dz)
            c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
            a, b = joint.still, joint.turned
            local = (c * a[0] + s * b[0], c * a[1] + s * b[1], c * a[2] + s * b[2], c * a[3] + s * b[3])
            turn = _multiply(turn, local)
            origins.append(position)
            axes.append(_rotate(turn, joint.axis))
        return origins, axes, position, turn

    def _angles(self, joints: ArrayLike) -> list[float]:
        array = np.asarray(joints, dtype=np.float64)
        if array.shape != (self.dof,) or not np.isfinite(array).all():
            raise KinematicsError(f"joint angles must be {self.dof} finite numbers, got {array.tolist()}")
        angles: list[float] = array.tolist()
        return angles

    def _tcp(self) -> NDArray[np.float64]:
        if self.tcp_offset is None:
            raise KinematicsError("the spec gives no tcp for this embodiment's end effector; use the flange")
        return self.tcp_offset


def _with_kinematics() -> list[str]:
    return sorted(name for name, entry in robots.entries().items() if robots.has_frames(entry))


def _joint(entry: Entry) -> _Joint:
    still = rotation.from_rpy(entry["origin"]["rpy"])
    axis = np.asarray(entry["axis"], dtype=np.float64)
    axis = axis / math.sqrt(float(np.sum(axis * axis)))
    turned = rotation.multiply(still, np.concatenate([[0.0], axis]))
    x, y, z = (float(value) for value in entry["origin"]["xyz"])
    return _Joint((x, y, z), tuple(axis.tolist()), tuple(still.tolist()), tuple(turned.tolist()))


def _checked_pose(values: ArrayLike) -> list[float]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (spec.POSE_DIM,) or not np.isfinite(array).all():
        raise KinematicsError(f"a target pose must be {spec.POSE_DIM} finite numbers, got {array.tolist()}")
    array = pose(array[: spec.POSITION_DIM], rotation.normalise(array[spec.POSITION_DIM :]))
    checked: list[float] = array.tolist()
    return checked


def _cost(solution: Solution) -> float:
    return solution.position_error**2 + (_METRES_PER_RADIAN * solution.rotation_error) ** 2


def _multiply(p: _Quaternion, q: _Quaternion) -> _Quaternion:
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


def _rotate(q: _Quaternion, v: _Vector) -> _Vector:
    w, x, y, z = q
    a, b, c = 2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])
    return (v[0] + w * a + y * c - z * b, v[1] + w * b + z * a - x * c, v[2] + w * c + x * b - y * a)


def _length(v: Sequence[float]) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def _rotation_error(goal: _Quaternion, turn: _Quaternion) -> _Vector:
    """Return the rotation vector, in the base, that takes `turn` to `goal` the shorter way."""
    w, x, y, z = _multiply(goal, (turn[0], -turn[1], -turn[2], -turn[3]))
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = _length((x, y, z))
    factor = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return (factor * x, factor * y, factor * z)


def _column(origin: _Vector, axis: _Vector, point: _Vector, angular: float) -> tuple[float, ...]:
    """Return one column of the Jacobian, its angular rows scaled by `angular`."""
    x, y, z = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
    a, b, c = axis
    return (b * z - c * y, c * x - a * z, a * y - b * x, angular * a, angular * b, angular * c)


def _step(
    columns: Sequence[Sequence[float]],
    residual: Sequence[float],
    angles: Sequence[float],
    limits: Sequence[tuple[float, float]],
    damping: float,
) -> list[float]:
    """Return the angles after one damped least-squares step that respects the limits.

    A joint that would pass its limit is put there and its column moves to the right-hand side; the rest is solved
    again. Each round fixes at least one joint, so this ends.
    """
    size = len(angles)
    change = [0.0] * size
    free = list(range(size))
    while free:
        rest = list(residual)
        for index in range(size):
            if index not in free and change[index]:
                rest = [value - change[index] * entry for value, entry in zip(rest, columns[index])]
        solution = _damped_least_squares([columns[index] for index in free], rest, damping)
        for index, value in zip(free, solution):
            change[index] = value
        outside = [index for index in free if not limits[index][0] <= angles[index] + change[index] <= limits[index][1]]
        if not outside:
            break
        for index in outside:
            change[index] = limits[index][change[index] > 0] - angles[index]
        free = [index for index in free if index not in outside]
    scale = min(1.0, _LARGEST_STEP / max(1e-12, *map(abs, change)))
    return [min(max(angle + scale * value, low), high) for angle, value, (low, high) in zip(angles, change, limits)]


def _damped_least_squares(columns: Sequence[Sequence[float]], residual: Sequence[float], damping: float) -> list[float]:
    """Solve ``(J^T J + damping I) x = J^T r`` by Cholesky's method; `columns` are those of J."""
    size = len(columns)
    factor: list[list[float]] = []
    x: list[float] = []
    for i in range(size):
        own = columns[i]
        row: list[float] = []
        for j in range(i):
            known = factor[j]
            value = _dot(own, columns[j])
            for k in range(j):
                value -= row[k] * known[k]
            row.append(value / known[j])
        pivot = _dot(own, own) + damping
        value = _dot(own, residual)
        for k in range(i):
            pivot -= row[k] * row[k]
            value -= row[k] * x[k]
        row.append(math.sqrt(max(pivot, _DAMPING_FLOOR * _DAMPING_FLOOR)))
        x.append(value / row[i])
        factor.append(row)
    for i in reversed(range(size)):
        value = x[i]
        for k in range(i + 1, size):
            value -= factor[k][i] * x[k]
        x[i] = value / factor[i][i]
    return x


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]
