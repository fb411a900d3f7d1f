"""Consistency of joints and poses under an arm's forward kinematics, for every way to read them.

Each reading of a pose has an error: the root mean square, over the rows, of its distance (mm) or angle (degrees) to
where the joints put the flange. What is declared is beaten if another reading has a third of its error or less.
If errors of readings are alike, these rows do not distinguish them, and the verdict says so.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import poses
from xpl.kinematics import Chain, KinematicsError
from xpl_cli.model_io.kinematics import readings, residual

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl import Embodiment
    from xpl_cli.model_io.kinematics.readings import JointReading
    from xpl_cli.model_io.kinematics.samples import SampleColumns

POSITION, ROTATION, JOINTS = "position", "rotation", "joints"
AGREES, DIFFERS, ANSWERS, UNEXPLAINED, OPEN = "agrees", "differs", "answers", "unexplained", "cannot tell"
_UNIT = {POSITION: "mm", ROTATION: "degrees"}
_FLOOR = {POSITION: 0.5, ROTATION: 0.1}
"""Errors up to which readings are alike: arms are not built more exactly than that."""
_TOLERANCE = {POSITION: 30.0, ROTATION: 5.0}
"""Errors of measured states up to which something is explained: calibration, and clocks that are not quite one."""
_BEATEN = 3.0
"""How many times the error of another reading is that of one that is beaten."""
_FEWEST = 3
_LEAST_MOTION = {POSITION: 20.0, ROTATION: 10.0}
"""How far apart the poses have to be."""


@dataclass(frozen=True)
class KinematicsVerdict:
    """What the rows say of one part.

    Attributes:
        where: the part, such as `model_io.samples 0, rotation left`.
        arm: of the robot.
        kind: joints, position or rotation.
        outcome: agrees, differs, answers (it differs only in what the block leaves open), unexplained or cannot tell.
        rows: how many were looked at.
        declared: its words as declared.
        declared_error: of the declared reading, mm or degrees; of joints that of the first pose.
        best: the words that fit best, without those that are declared; {} if that is the declared reading.
        best_error: its error.
        next_error: that of the next distinguishable reading: the margin.
        unit: of the errors.
        open: words that these rows leave open, with the values that fit alike.
        because: why there is no verdict, or the residual.
        unknown: words that the block leaves open.
    """

    where: str
    arm: str
    kind: str
    outcome: str
    rows: int
    declared: Mapping[str, str] = field(default_factory=dict)
    declared_error: float | None = None
    best: Mapping[str, str] = field(default_factory=dict)
    best_error: float | None = None
    next_error: float | None = None
    unit: str = ""
    open: Mapping[str, Sequence[str]] = field(default_factory=dict)
    because: str = ""
    unknown: Sequence[str] = ()

    @property
    def change(self) -> str:
        """The words that fit best, as the block writes them."""
        return _format_words(self.best)

    @property
    def replaced(self) -> str:
        """What is declared where other words fit better."""
        words = {key: self.declared[key] for key in self.best if key in self.declared}
        return _format_words(words) or "what is declared"

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        if self.outcome == OPEN:
            return f"{self.where}: cannot tell: {self.because}"
        errors = f"{_figure(self.declared_error)} {self.unit}"
        if self.outcome == UNEXPLAINED:
            return f"{self.where}: {errors} from where the joints put it, and no words explain that; {self.because}"
        if self.outcome == ANSWERS:
            fit = f"{self.change} fits to {_figure(self.best_error)} {self.unit}"
            return f"{self.where}: these rows tell what is open: {fit}{self._margin}"
        if self.outcome == DIFFERS:
            fit = f"{self.change} fits to {_figure(self.best_error)} {self.unit}"
            return f"{self.where}: {fit}, {self.replaced} only to {_figure(self.declared_error)}{self._margin}"
        return f"{self.where}: agrees to {errors}{self._margin}"

    @property
    def _margin(self) -> str:
        margin = f"; the next reading is at {_figure(self.next_error)}" if self.next_error is not None else ""
        undetermined = "; ".join(f"{key} {' or '.join(values)}" for key, values in self.open.items())
        return f"{margin}; these rows do not tell {undetermined}" if undetermined else margin

    def document(self) -> dict[str, Any]:
        """Return the verdict as JSON; errors to a thousandth, so that machines agree."""
        return {key: round(value, 3) if isinstance(value, float) else value for key, value in asdict(self).items()}


def _format_words(words: Mapping[str, str]) -> str:
    return ", ".join(value if key == JOINTS else f"{key}: {value}" for key, value in words.items())


def _figure(error: float | None) -> str:
    """Return an error as people read it: nothing below a hundredth."""
    return f"{error or 0.0:.3g}" if (error or 0.0) >= 0.01 else "0"


@dataclass
class _ArmKinematics:
    """The kinematics of one arm, for each way to read its joints."""

    embodiment: Embodiment
    side: str
    chain: Chain
    options: list[JointReading]

    def flange(self, option: int) -> np.ndarray:
        """Return the flange's poses (N, 7) in the arm's base, for one way to read the joints."""
        return self._flanges[option]

    def expected(self, option: int, target: tuple[str, str, str]) -> np.ndarray:
        """Return the poses (N, 7) of a point in a frame."""
        outer, inner = readings.offsets(self.embodiment, *target)
        return poses.compose(poses.compose(outer, self.flange(option)), inner)

    @cached_property
    def _flanges(self) -> list[np.ndarray]:
        return [np.stack([self.chain.flange(row) for row in angles.values]) for angles in self.options]


def judge(columns: Sequence[SampleColumns], embodiment: Embodiment) -> list[KinematicsVerdict]:
    """Return what the robot's kinematics says of each part; nothing where joints or poses are missing.

    Raises:
        KinematicsError: if the standard has no kinematics of the robot.
    """
    chain = Chain.from_embodiment(embodiment.data)
    verdicts: list[KinematicsVerdict] = []
    for side in embodiment.data["arms"]:
        own_columns = [one for one in columns if one.entry["arm"] == side]
        for leads in (False, True):
            poses = [one for one in own_columns if one.kind != JOINTS and one.leads is leads]
            joints = _joints(own_columns, leads=leads)
            if poses and joints is not None:
                others = [one for one in columns if one.kind == JOINTS and one.entry["arm"] != side]
                options = list(readings.joints(joints, _joints(others, leads=leads), embodiment))
                verdicts += _judge_arm(_ArmKinematics(embodiment, side, chain, options), joints, poses)
    return verdicts


def has_kinematics(embodiment: Embodiment) -> bool:
    """Tell whether the standard has the joint frames of a robot."""
    try:
        Chain.from_embodiment(embodiment.data)
    except KinematicsError:
        return False
    return True


def _joints(columns: Sequence[SampleColumns], *, leads: bool) -> SampleColumns | None:
    """Return an arm's joints; of the same kind, if there are some: commands lead what is measured."""
    candidates = [one for one in columns if one.kind == JOINTS]
    return next((one for one in candidates if one.leads is leads), candidates[0] if candidates else None)


def _judge_arm(
    arm: _ArmKinematics, joints: SampleColumns, pose_columns: Sequence[SampleColumns]
) -> Iterator[KinematicsVerdict]:
    reason = _describe_too_little_motion(arm)
    if reason:
        for one in (joints, *pose_columns):
            yield KinematicsVerdict(one.where, arm.side, one.kind, OPEN, len(one.rows), because=reason)
        return
    table = [_ReadingErrors(one, arm, follows=one.leads is not joints.leads) for one in pose_columns]
    every = range(len(arm.options))
    if all(one.least(0) <= one.tolerance for one in table):  # with these readings: may the joints be other ones?
        errors = [[one.of_best(option) / _FLOOR[one.kind] for option in every] for one in table]
    else:
        errors = [[one.least(option) / _FLOOR[one.kind] for option in every] for one in table]
    cost = np.sum(errors, axis=0)
    alike = cost <= max(float(len(table)), _BEATEN * cost.min())
    option = 0 if alike[0] else int(cost.argmin())
    yield _of_joints(arm, joints, table, alike, option)
    for pose in table:
        yield pose.verdict(option)


def _of_joints(
    arm: _ArmKinematics, joints: SampleColumns, table: Sequence[_ReadingErrors], alike: np.ndarray, option: int
) -> KinematicsVerdict:
    """Return what is said of the joints, which are read in one way, and could be in those that fit alike."""
    first = table[0]
    explained = any(one.least(option) <= one.tolerance for one in table)
    change = arm.options[option].change
    outcome = AGREES if not option else ANSWERS if change.partition(":")[0] in joints.unknown else DIFFERS
    changes = [arm.options[index].change or "as declared" for index in np.flatnonzero(alike) if index != option]
    return KinematicsVerdict(
        joints.where,
        arm.side,
        JOINTS,
        outcome if explained or option else OPEN,
        len(joints.rows),
        declared_error=first.least(0),
        best={JOINTS: change} if option else {},
        best_error=first.least(option),
        unit=_UNIT[first.kind],
        open={JOINTS: changes} if changes and explained else {},
        because="" if explained else "no reading of the joints explains the poses",
        unknown=sorted(joints.unknown),
    )


def _describe_too_little_motion(arm: _ArmKinematics) -> str:
    """Return why these rows are too much alike, "" if they are not."""
    flange = arm.flange(0)
    different = len(np.unique(flange.round(4), axis=0))
    if different < _FEWEST:
        return f"the rows hold {different} different poses, and at least {_FEWEST} are needed"
    distance = 1000 * float(np.linalg.norm(flange[:, :3] - flange[0, :3], axis=-1).max())
    angle = float(residual.angles(flange[:, 3:], flange[:1, 3:]).max())
    if distance < _LEAST_MOTION[POSITION] or angle < _LEAST_MOTION[ROTATION]:
        return f"the poses lie within {distance:.1f} mm and {angle:.1f} degrees of the first: too much alike"
    return ""


class _ReadingErrors:
    """The errors of every reading of one pose's columns, under every reading of the joints.

    Args:
        columns: positions or rotations.
        arm: its kinematics.
        follows: whether these are commands and the joints are measured, or the other way round.
    """

    def __init__(self, columns: SampleColumns, arm: _ArmKinematics, *, follows: bool) -> None:
        self.kind = columns.kind
        self.tolerance = _TOLERANCE[self.kind]
        self._columns, self._arm, self._follows = columns, arm, follows
        read = readings.positions if self.kind == POSITION else readings.turns
        self._read = read(columns, arm.embodiment)
        self._known: dict[int, np.ndarray] = {}

    def least(self, option: int) -> float:
        """Return the error of the reading that fits best."""
        return float(self._of(option).min())

    def of_best(self, option: int) -> float:
        """Return the error of the reading that fits best with the joints as declared."""
        errors = self._of(0)
        word, target = map(int, np.unravel_index(errors.argmin(), errors.shape))
        return float(self._errors(option, slice(word, word + 1), [self._read.targets[target]])[0, 0])

    def verdict(self, option: int) -> KinematicsVerdict:
        """Return the verdict on these columns, with the joints read in one way."""
        errors = self._of(option)
        floor, declared, least = _FLOOR[self.kind], float(errors[0, 0]), float(errors.min())
        holds = declared <= max(floor, _BEATEN * least)
        alike = errors <= max(floor, 2 * least)
        alike[0, 0] |= holds
        alike_readings = [(int(word), int(target)) for word, target in np.argwhere(alike)]
        chosen = (0, 0) if holds else min(alike_readings, key=self._distance)
        words, best = self._read.words_of(0, 0), self._read.words_of(*chosen)
        unknown = self._columns.unknown
        changed = {key: value for key, value in best.items() if words.get(key) != value or key in unknown}
        outcome = ANSWERS if changed and changed.keys() <= unknown else AGREES if holds else DIFFERS
        because = ""
        if holds and least > self.tolerance:
            outcome, because = UNEXPLAINED, ""
            if self._follows:
                outcome, because = OPEN, "commands and measured joints lie too far apart"
            else:
                because = self._leftover(option)
        others = errors[~alike]
        return KinematicsVerdict(
            self._columns.where,
            self._arm.side,
            self.kind,
            outcome,
            len(self._columns.rows),
            words,
            declared,
            {} if outcome == UNEXPLAINED else changed,
            float(errors[chosen]),
            float(others.min()) if others.size else None,
            _UNIT[self.kind],
            self._open(alike_readings) if outcome in {AGREES, DIFFERS, ANSWERS} else {},
            because,
            sorted(unknown),
        )

    def _distance(self, reading: tuple[int, int]) -> tuple[int, int]:
        """Return how much a reading changes of what is declared: what no word says, and words."""
        words = self._read.words_of(0, 0)
        changed = [value for key, value in self._read.words_of(*reading).items() if words.get(key) != value]
        return sum(readings.NO_WORD in value for value in changed), len(changed)

    def _open(self, alike: Sequence[tuple[int, int]]) -> dict[str, list[str]]:
        """Return the words on which readings that fit alike are not one, with their values."""
        readings_alike = [self._read.words_of(*reading) for reading in alike]
        values = {
            key: list(dict.fromkeys(words.get(key, "none") for words in readings_alike)) for key in readings_alike[0]
        }
        return {key: options_left for key, options_left in values.items() if len(options_left) > 1}

    def _of(self, option: int) -> np.ndarray:
        """Return the error of each reading (W, P), mm or degrees."""
        if option not in self._known:
            self._known[option] = self._errors(option, slice(None), self._read.targets)
        return self._known[option]

    def _errors(self, option: int, words: slice, targets: Sequence[tuple[str, str, str]]) -> np.ndarray:
        values = self._read.values[words, None]
        expected = np.stack([self._arm.expected(option, target) for target in targets])[None]
        if self.kind == POSITION:
            apart = 1000 * np.linalg.norm(values - expected[..., :3], axis=-1)
        else:
            apart = residual.angles(values, expected[..., 3:])
        result: np.ndarray = np.sqrt((apart * apart).mean(-1))
        return result

    def _leftover(self, option: int) -> str:
        """Return what a fixed turn or shift would explain."""
        if self.kind == POSITION:
            return residual.of_positions(self._read.values[0], self._arm.expected(option, self._read.targets[0]))
        return residual.of_rotations(self._read, [self._arm.expected(option, target) for target in self._read.targets])
