"""The probe: reads a sample of episodes, measures every convention, and reports what it could not measure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl.catalogue import convention as catalogue
from xpl.embodiment import embodiment_names
from xpl_cli.data.probe import cameras, commands, grippers, parts, states
from xpl_cli.data.probe.answer import ProbeAnswer, unknown
from xpl_cli.data.probe.parts import GRIPPER, POSITION, ROTATION
from xpl_cli.data.probe.sample import COMMAND, STATE, Sample, is_clock, read_sample

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl_cli.data.probe.commands import CommandPlot
    from xpl_cli.data.probe.parts import VectorPart
    from xpl_cli.data.probe.states import ArmState
    from xpl_cli.data.sets.interface import Demonstrations

EPISODES: Final = 24
_CLOCK_UNITS: Final = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
_SLOWEST, _FASTEST = 0.5, 500.0


@dataclass
class ProbeResult:
    """The result of a probe.

    Attributes:
        answers: one for each convention, known or unknown.
        state, command: the parts of the columns.
        arms: the state of each arm.
        plots: of commands and states.
        episodes, rows: how many were read.
    """

    answers: list[ProbeAnswer]
    state: list[VectorPart]
    command: list[VectorPart]
    arms: dict[int, ArmState] = field(default_factory=dict)
    plots: list[CommandPlot] = field(default_factory=list)
    episodes: int = 0
    rows: int = 0

    def of(self, topic: str, subject: str) -> ProbeAnswer | None:
        """Return the answer for a topic and a subject; None if there is none."""
        return next((one for one in self.answers if (one.topic, one.subject) == (topic, subject)), None)

    def value(self, topic: str, subject: str) -> Any:
        """Return the value for a topic and a subject; None if it is unknown."""
        answer = self.of(topic, subject)
        return None if answer is None else answer.value


def probe(
    demonstrations: Demonstrations,
    *,
    episodes: int = EPISODES,
    robot: str | None = None,
    images: bool = True,
    report_progress: Callable[[str], None] = lambda _: None,
) -> ProbeResult:
    """Measure the conventions of a dataset.

    Args:
        demonstrations: the dataset.
        episodes: number of episodes that are read, evenly spread.
        images: whether to analyse cameras.
        robot: name of the embodiment, where the user knows it; by default the dataset's robot, if it is an embodiment.
        report_progress: called with one line for each part of the work.

    Raises:
        DataError: a column or an image cannot be read.
    """
    sample = read_sample(demonstrations, episodes, report_progress)
    robot_name = robot or (demonstrations.robot if demonstrations.robot in embodiment_names() else None)
    state, command = parts.split_columns(sample.of(STATE)), parts.split_columns(sample.of(COMMAND))
    result = ProbeResult([_rate(sample, demonstrations)], state, command, episodes=len(sample.episodes))
    result.rows = sample.steps
    if not sample.episodes:
        return result
    scaled = {role: _normalised(sample, role) for role in (STATE, COMMAND)}
    result.answers += [answer for answer in scaled.values() if answer is not None]
    is_normalised = any(answer is not None and answer.value is not None for answer in scaled.values())
    names = [episode.instructions for episode in sample.episodes]
    for arm in sorted({part.arm for part in (*state, *command)}):
        report_progress(f"arm {arm + 1}")
        own = [part for part in state if part.arm == arm]
        their = [part for part in command if part.arm == arm]
        arm_state, *others = _states(own, robot_name) if scaled[STATE] is None else [states.plain(own)]
        result.arms[arm] = arm_state
        analysis = commands.of_arm(their, arm_state, normalised=is_normalised)
        result.answers += [*arm_state.answers, *_new_answers(arm_state, others), *analysis.answers]
        result.plots += analysis.plots
        pair = [next((part for part in ones if part.kind == GRIPPER), None) for ones in (own, their)]
        result.answers += grippers.probe_gripper(pair[0], pair[1], names)
    for part in (*state, *command):
        if part.kind == parts.UNKNOWN:
            why = f"{part.width} numbers that move neither like an arm nor like a gripper"
            result.answers.append(unknown("kind", part.subject, why, "names of the numbers"))
    result.answers.append(_idle(result))
    result.answers += [answer for one in catalogue.installed() if one.probe is not None for answer in one.probe(sample)]
    if images:
        result.answers += cameras.probe_cameras(sample.episodes, _moving(result), _heights(result), report_progress)
    return result


def _states(own: list[VectorPart], robot: str | None) -> list[ArmState]:
    """Return an arm's state, once for each pose with a column of its own, such as flange and TCP."""
    posed = {part.series.name for part in own if part.kind == POSITION}
    posed &= {part.series.name for part in own if part.kind == ROTATION}
    if len(posed) < 2:
        return [states.of_arm(own, robot)]
    rest = [part for part in own if part.series.name not in posed]
    return [
        states.of_arm([*rest, *(part for part in own if part.series.name == name)], robot) for name in sorted(posed)
    ]


def _new_answers(first: ArmState, others: list[ArmState]) -> list[ProbeAnswer]:
    """Return the answers of an arm's other poses that the first has not."""
    first_keys = {(answer.topic, answer.subject) for answer in first.answers}
    return [answer for one in others for answer in one.answers if (answer.topic, answer.subject) not in first_keys]


def _rate(sample: Sample, demonstrations: Demonstrations) -> ProbeAnswer:
    """Return the answer for the rate, by columns of timestamps."""
    for series in sample.series:
        if not is_clock(series.name) or series.width != 1:
            continue
        steps = np.concatenate([np.diff(rows[:, 0]) for rows in series.rows])
        middle = float(np.median(steps)) if len(steps) else 0.0
        if middle <= 0:
            continue
        units = [(unit, 1 / (middle * scale)) for unit, scale in _CLOCK_UNITS]
        fits = [(unit, rate) for unit, rate in units if _SLOWEST <= rate <= _FASTEST]
        if len(fits) != 1 or (middle == 1.0 and (steps == 1.0).all()):
            continue
        unit, rate = fits[0]
        regular = float((np.abs(steps - middle) < 0.2 * middle).mean())
        evidence = f"{series.name} advances by {middle:.4g} {unit} per step, in {100 * regular:.0f} % of the steps"
        stated = demonstrations.rate_hz
        if stated is not None and abs(stated - rate) > 0.05 * rate:
            evidence += f"; it contradicts the dataset's {stated:g} Hz"
        return ProbeAnswer("rate", "set", round(rate, 2), evidence)
    if demonstrations.rate_hz is not None:
        return ProbeAnswer(
            "rate", "set", demonstrations.rate_hz, "stated by the dataset; no timestamps were recorded", declared=True
        )
    return unknown(
        "rate", "set", "no column holds timestamps, and the dataset states no rate", "a column of timestamps"
    )


def _normalised(sample: Sample, role: str) -> ProbeAnswer | None:
    """Return an answer if the columns of a role look normalised, else None."""
    for series in sample.of(role):
        rows = series.stacked
        moving = rows[:, np.ptp(rows, axis=0) > 1e-9]
        if moving.shape[1] < 4:
            continue
        low, high = moving.min(0), moving.max(0)
        touched = (np.abs(low + 1) < 0.02) & (np.abs(high - 1) < 0.02)
        inside = (low > -1.02) & (high < 1.02)
        if inside.all() and touched.mean() > 0.8 and not (np.abs(np.median(moving, 0)) < 1e-6).all():
            evidence = f"{touched.sum()} of {len(touched)} numbers range from -1 to 1 exactly"
            return ProbeAnswer("normalize", series.name, "min_max", evidence, float(touched.sum()))
        mean, deviation = np.abs(moving.mean(0)), moving.std(0)
        if (mean < 0.1).mean() > 0.8 and (np.abs(deviation - 1) < 0.1).mean() > 0.8:
            off = np.abs(deviation - 1).max()
            evidence = f"means are within {mean.max():.2g} of 0 and deviations within {off:.2g} of 1"
            return ProbeAnswer("normalize", series.name, "mean_std", evidence, 1 / max(float(np.median(mean)), 0.01))
    return None


def _moving(result: ProbeResult) -> dict[str, list[np.ndarray]]:
    """Return for each arm its joints or positions, by episode."""
    moving = {}
    for arm, arm_state in result.arms.items():
        part = arm_state.joints or arm_state.position or arm_state.unsure
        if part is not None:
            is_placed = arm_state.reading is not None and arm_state.reading.frame == "world"
            side = arm_state.reading.side if arm_state.reading is not None and is_placed else part.side
            moving[side if side in {"left", "right"} else f"arm {arm + 1}"] = part.rows
    return moving


def _heights(result: ProbeResult) -> dict[str, list[np.ndarray]]:
    """Return for each arm its height, by episode, from poses in the world or in an upright base."""
    heights = {}
    for arm, arm_state in result.arms.items():
        if arm_state.position is not None:
            heights[f"arm {arm + 1}"] = [rows[:, 2] for rows in arm_state.position.rows]
    return heights


def _idle(result: ProbeResult) -> ProbeAnswer:
    """Return the number of idle steps at the start of episodes."""
    waits: list[int] = []
    moving = list(_moving(result).values())
    if not moving:
        return unknown("idle start", "set", "no arm is known", "columns of joints or poses")
    for rows in zip(*moving, strict=True):
        speed = np.sum([np.linalg.norm(np.diff(one, axis=0), axis=1) for one in rows], axis=0)
        fast = float(np.quantile(speed, 0.95))
        begun = np.flatnonzero(speed > 0.1 * fast) if fast > 0 else np.array([len(speed)])
        waits.append(int(begun[0]) if len(begun) else len(speed))
    middle = int(np.median(waits))
    evidence = f"the arm is idle for {middle} steps in the median of {len(waits)} episodes, for {max(waits)} at most"
    return ProbeAnswer("idle start", "set", middle, evidence)
