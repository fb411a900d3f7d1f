"""Checks of a robot's numbers: limits of joints, ranges of grippers, lengths and signs of quaternions."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import get_embodiment
from xpl_cli.audit.demonstrations.check import DatasetInfo, DemonstrationCheck, EpisodeData
from xpl_cli.audit.rules.model import Finding, NotApplicable
from xpl_cli.data.probe.parts import GRIPPER

if TYPE_CHECKING:
    from collections.abc import Iterator

_UNIT: Final = 0.02
"""How far the length of a quaternion may be off."""
_MOSTLY: Final = 0.8
_OUTSIDE: Final = 0.05
"""How far a joint may stand beyond its limit, rad: controllers overshoot, and limits are rounded."""
_BEYOND: Final = 0.15
"""How far a gripper may leave its usual range, a share of it."""
_STANDARD: Final = "xpl"


class JointLimits(DemonstrationCheck):
    """Joints are within the robot's limits.

    ## What it does
    Compares the joints that the probe finds, states and commands, with the limits of the robot that the set or
    `--robot` names, or that kinematics finds. More than 0.05 rad beyond a limit is a finding.

    ## Why it matters
    A joint beyond its limit means another joint order, unit or robot: a policy that is trained on it commands what the
    robot refuses.

    ## Example
    Joint 4 of a Franka at +0.3 rad, where it ends at -0.07.

    ## Use instead
    Look at `xpl data probe`: order, unit and sign of the joints.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL704", "joint-limits", "must"
    needs_probe = True

    def __init__(self, dataset: DatasetInfo) -> None:
        super().__init__(dataset)
        self._columns: list[tuple[str, int, int, float]] = []
        robot = dataset.robot
        probe_result = dataset.found
        if robot is None:
            robots = {one.value for one in probe_result.answers if one.topic == "robot" and one.is_known}
            robot = robots.pop() if len(robots) == 1 else None
        self._robot = robot
        for part in (*probe_result.state, *probe_result.command):
            unit = probe_result.value("angle unit", part.subject)
            if unit and probe_result.value("reference", part.subject) in {None, "absolute"}:
                self._columns.append((part.series.name, part.start, part.stop, np.pi / 180 if unit == "deg" else 1.0))
        self._order = {
            one.subject: one.value for one in probe_result.answers if one.topic == "joint order" and one.is_known
        }

    def inspect(self, episode: EpisodeData) -> None:
        """Compare its joints."""
        if self._robot is None:
            raise NotApplicable("the dataset names no known robot, and the probe identifies none: name it with --robot")
        if not self._columns:
            raise NotApplicable("no column is known to hold joints")
        arm = get_embodiment(self._robot).arms[0]
        names = list(arm.joint_names or ())
        for column, start, stop, unit in self._columns:
            if column not in episode.columns or arm.lower is None or arm.upper is None or stop - start != arm.dof:
                continue
            rows = episode.columns[column][:, start:stop] * unit
            order = next((value for subject, value in self._order.items() if subject.startswith(column)), names)
            columns_of_names = (
                [names.index(name) for name in order] if set(order) == set(names) else list(range(arm.dof))
            )
            excess = np.maximum(arm.lower[columns_of_names] - rows, rows - arm.upper[columns_of_names])
            for number in np.flatnonzero((excess > _OUTSIDE).any(0)):
                row = int(excess[:, number].argmax())
                name = names[columns_of_names[number]] if names else f"number {number}"
                what = f"{name} in {column} is beyond its limits on {self._robot}"
                self.tally.add(what, f"{episode.key} (step {row}, by {excess[row, number]:.2g} rad)")


class GripperRange(DemonstrationCheck):
    """Grippers stay in their range.

    ## What it does
    In the standard's format a gripper is 0 (closed) to 1 (open). In others an episode is compared with the range that
    most episodes have: what leaves it by more than 15 % is a finding.

    ## Why it matters
    An episode with another unit or calibration teaches that half open is closed. Normalisation by the range of the data
    makes it worse: one wrong episode compresses the range of all others.

    ## Example
    Episode 7 has 0 to 255, all others 0 to 1.

    ## Use instead
    Convert the episode, or leave it out.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL705", "gripper-range", "must"
    needs_probe = True

    def __init__(self, dataset: DatasetInfo) -> None:
        super().__init__(dataset)
        parts = (*dataset.found.state, *dataset.found.command)
        self._columns = [(part.series.name, part.start, part.stop) for part in parts if part.kind == GRIPPER]
        self._ranges: dict[tuple[str, int], list[tuple[str, float, float]]] = {}

    def inspect(self, episode: EpisodeData) -> None:
        """Record its ranges."""
        if not self._columns:
            raise NotApplicable("no column is known to be a gripper")
        for column, start, stop in self._columns:
            rows = episode.columns.get(column)
            if rows is None or not len(rows) or rows.shape[1] < stop or not np.isfinite(rows).all():
                continue
            for index in range(start, stop):
                low, high = float(rows[:, index].min()), float(rows[:, index].max())
                self._ranges.setdefault((column, index), []).append((episode.key, low, high))

    def findings(self) -> Iterator[Finding]:
        """Yield episodes that leave the range."""
        for (column, _), entries in self._ranges.items():
            lows, highs = np.array([low for _, low, _ in entries]), np.array([high for _, _, high in entries])
            low, high = (0.0, 1.0) if self.about.format == _STANDARD else self._usual(lows, highs)
            tolerance = (0.02 if self.about.format == _STANDARD else _BEYOND) * (high - low)
            if high <= low:
                continue
            for key, least, most in entries:
                if least < low - tolerance or most > high + tolerance:
                    what = f"the gripper in {column} leaves {low:.4g} to {high:.4g}"
                    self.tally.add(what, f"{key} ({least:.4g} to {most:.4g})")
        yield from self.tally.findings()

    @staticmethod
    def _usual(lows: np.ndarray, highs: np.ndarray) -> tuple[float, float]:
        """Return the range that three quarters of the episodes stay in."""
        return float(np.quantile(lows, 0.25)), float(np.quantile(highs, 0.75))


class _QuaternionCheck(DemonstrationCheck):
    """Base class of the checks of quaternions."""

    def __init__(self, dataset: DatasetInfo) -> None:
        super().__init__(dataset)
        self._has_quaternions = False

    def inspect(self, episode: EpisodeData) -> None:
        """Inspect its quaternions."""
        for name, start in _find_quaternions(episode):
            self._has_quaternions = True
            problem = self._find_problem(episode.columns[name][:, start : start + 4])
            if problem is not None:
                what, where = problem
                self.tally.add(f"{name}[{start}:{start + 4}] {what}", f"{episode.key} ({where})")

    @abstractmethod
    def _find_problem(self, rows: np.ndarray) -> tuple[str, str] | None:
        """Return the problem of quaternions (T, 4), and its location; None if there is none."""

    def findings(self) -> Iterator[Finding]:
        """Yield quaternions with problems."""
        if not self._has_quaternions:
            raise NotApplicable("no column holds quaternions")
        yield from self.tally.findings()


class QuaternionNorm(_QuaternionCheck):
    """Quaternions have the length 1.

    ## What it does
    Detects quaternions by their length of 1 in most rows, and reports the other rows.

    ## Why it matters
    A row of zeros, or of numbers that were averaged or filtered one by one, is not a rotation. Code that reads it turns
    it into some rotation without an error.

    ## Example
    The first pose of an episode is [0, 0, 0, 0], because the tracker had not started.

    ## Use instead
    Cut the rows; scale what was filtered.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL707", "quaternion-norm", "must"

    def _find_problem(self, rows: np.ndarray) -> tuple[str, str] | None:
        off = np.abs(np.linalg.norm(rows, axis=1) - 1)
        wrong = np.flatnonzero(off > _UNIT)
        if not len(wrong):
            return None
        return "is a quaternion of another length than 1", f"step {wrong[0]}, off by {off.max():.2g}"


class QuaternionSign(_QuaternionCheck):
    """Quaternions do not change their sign from one step to the next.

    ## What it does
    Finds steps in which a quaternion becomes nearly its negative, which is the same rotation.

    ## Why it matters
    q and -q are one rotation and two targets. A network that learns both predicts their mean, which is not a rotation.
    Differences of quaternions, and statistics, are wrong at each such step.

    ## Example
    [0.01, 1, 0, 0] and then [-0.01, -1, 0, 0].

    ## Use instead
    Keep the sign continuous when you convert, or w >= 0 where the robot stays away from w = 0.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL708", "quaternion-sign", "should"

    def _find_problem(self, rows: np.ndarray) -> tuple[str, str] | None:
        flips = np.flatnonzero((rows[1:] * rows[:-1]).sum(1) < -0.9)
        if not len(flips):
            return None
        return "changes the sign of its quaternion", f"{len(flips)} times, first at step {flips[0] + 1}"


def _find_quaternions(episode: EpisodeData) -> Iterator[tuple[str, int]]:
    """Yield column and start index of each quaternion."""
    for name, rows in episode.columns.items():
        at = 0
        while at + 4 <= rows.shape[1]:
            four = rows[:, at : at + 4]
            unit = np.abs(np.linalg.norm(four, axis=1) - 1) < 2e-3
            if len(rows) and unit.mean() > _MOSTLY and (np.ptp(four[unit], axis=0) > 1e-9).sum() >= 2:
                yield name, at
                at += 4
            else:
                at += 1
