"""The probe: reads some episodes, measures every convention, and tells what it could not measure."""

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
    """What a probe found.

    Attributes:
        answers: one for each convention, known or not.
        state, command: the parts of the columns.
        arms: what each arm's state is.
        plots: lines that show it.
        episodes, rows: how much was read.
    """

    answers: list[ProbeAnswer]
    state: list[VectorPart]
    command: list[VectorPart]
    arms: dict[int, ArmState] = field(default_factory=dict)
    plots: list[CommandPlot] = field(default_factory=list)
    episodes: int = 0
    rows: int = 0

    def of(self, topic: str, subject: str) -> ProbeAnswer | None:
        """Return the answer of a topic and a subject."""
        return next((one for one in self.answers if (one.topic, one.subject) == (topic, subject)), None)

    def value(self, topic: str, subject: str) -> Any:
        """Return what is known of a topic and a subject, None if nothing is."""
        found = self.of(topic, subject)
        return None if found is None else found.value


def probe(
    demonstrations: Demonstrations,
    *,
    episodes: int = EPISODES,
    robot: str | None = None,
    images: bool = True,
    report_progress: Callable[[str], None] = lambda _: None,
) -> ProbeResult:
    """Measure the conventions of a set.

    Args:
        demonstrations: the set.
        episodes: how many are read, evenly spread.
        images: whether cameras are looked at.
        robot: name of the embodiment, where the user knows it; by default what the set says, if that is one.
        report_progress: called with one line for each part of the work.

    Raises:
        DataError: a column or an image cannot be read.
    """
    sample = read_sample(demonstrations, episodes, report_progress)
    named = robot or (demonstrations.robot if demonstrations.robot in embodiment_names() else None)
    state, command = parts.split_columns(sample.of(STATE)), parts.split_columns(sample.of(COMMAND))
    found = ProbeResult([_rate(sample, demonstrations)], state, command, episodes=len(sample.episodes))
    found.rows = sample.steps
    if not sample.episodes:
        return found
    scaled = {role: _normalised(sample, role) for role in (STATE, COMMAND)}
    found.answers += [answer for answer in scaled.values() if answer is not None]
    is_normalised = any(answer is not None and answer.value is not None for answer in scaled.values())
    names = [episode.instructions for episode in sample.episodes]
    for arm in sorted({part.arm for part in (*state, *command)}):
        report_progress(f"arm {arm + 1}")
        own = [part for part in state if part.arm == arm]
        their = [part for part in command if part.arm == arm]
        seen, *others = _states(own, named) if scaled[STATE] is None else [states.plain(own)]
        found.arms[arm] = seen
        said = commands.of_arm(their, seen, normalised=is_normalised)
        found.answers += [*seen.answers, *_new_answers(seen, others), *said.answers]
        found.plots += said.plots
        pair = [next((part for part in ones if part.kind == GRIPPER), None) for ones in (own, their)]
        found.answers += grippers.probe_gripper(pair[0], pair[1], names)
    for part in (*state, *command):
        if part.kind == parts.UNKNOWN:
            why = f"{part.width} numbers that move like no arm and no gripper that is known"
            found.answers.append(unknown("kind", part.subject, why, "names of the numbers"))
    found.answers.append(_idle(found))
    found.answers += [answer for one in catalogue.others() if one.told_by is not None for answer in one.told_by(sample)]
    if images:
        found.answers += cameras.probe_cameras(sample.episodes, _moving(found), _heights(found), report_progress)
    return found


def _states(own: list[VectorPart], robot: str | None) -> list[ArmState]:
    """Return what an arm's state is: once for each pose of it that has its own column, such as flange and tcp."""
    posed = {part.series.name for part in own if part.kind == POSITION}
    posed &= {part.series.name for part in own if part.kind == ROTATION}
    if len(posed) < 2:
        return [states.of_arm(own, robot)]
    rest = [part for part in own if part.series.name not in posed]
    return [
        states.of_arm([*rest, *(part for part in own if part.series.name == name)], robot) for name in sorted(posed)
    ]


def _new_answers(seen: ArmState, others: list[ArmState]) -> list[ProbeAnswer]:
    """Return what other poses of an arm tell that the first does not."""
    known = {(answer.topic, answer.subject) for answer in seen.answers}
    return [answer for one in others for answer in one.answers if (answer.topic, answer.subject) not in known]


def _rate(sample: Sample, demonstrations: Demonstrations) -> ProbeAnswer:
    """Return the steps per second, by columns of times."""
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
        said = f"{series.name} goes on by {middle:.4g} {unit} a step, in {100 * regular:.0f} % of the steps"
        stated = demonstrations.rate_hz
        if stated is not None and abs(stated - rate) > 0.05 * rate:
            said += f"; the set says {stated:g} Hz, which is not so"
        return ProbeAnswer("rate", "set", round(rate, 2), said)
    if demonstrations.rate_hz is not None:
        return ProbeAnswer(
            "rate", "set", demonstrations.rate_hz, "the set says so; no times were recorded", declared=True
        )
    return unknown("rate", "set", "no column holds times, and the set says nothing", "a column of timestamps")


def _normalised(sample: Sample, role: str) -> ProbeAnswer | None:
    """Return that the columns of a role are normalised, None if nothing looks like it."""
    for series in sample.of(role):
        rows = series.stacked
        moving = rows[:, np.ptp(rows, axis=0) > 1e-9]
        if moving.shape[1] < 4:
            continue
        low, high = moving.min(0), moving.max(0)
        touched = (np.abs(low + 1) < 0.02) & (np.abs(high - 1) < 0.02)
        inside = (low > -1.02) & (high < 1.02)
        if inside.all() and touched.mean() > 0.8 and not (np.abs(np.median(moving, 0)) < 1e-6).all():
            said = f"{touched.sum()} of {len(touched)} numbers range from -1 to 1 exactly"
            return ProbeAnswer("normalize", series.name, "min_max", said, float(touched.sum()))
        mean, deviation = np.abs(moving.mean(0)), moving.std(0)
        if (mean < 0.1).mean() > 0.8 and (np.abs(deviation - 1) < 0.1).mean() > 0.8:
            off = np.abs(deviation - 1).max()
            said = f"means are within {mean.max():.2g} of 0 and deviations within {off:.2g} of 1"
            return ProbeAnswer("normalize", series.name, "mean_std", said, 1 / max(float(np.median(mean)), 0.01))
    return None


def _moving(found: ProbeResult) -> dict[str, list[np.ndarray]]:
    """Return for each arm what moves, by episode."""
    moving = {}
    for arm, seen in found.arms.items():
        part = seen.joints or seen.position or seen.unsure
        if part is not None:
            is_placed = seen.reading is not None and seen.reading.frame == "world"
            side = seen.reading.side if seen.reading is not None and is_placed else part.side
            moving[side if side in {"left", "right"} else f"arm {arm + 1}"] = part.rows
    return moving


def _heights(found: ProbeResult) -> dict[str, list[np.ndarray]]:
    """Return for each arm how high it is, by episode, where poses of the world or of an upright base say so."""
    heights = {}
    for arm, seen in found.arms.items():
        if seen.position is not None:
            heights[f"arm {arm + 1}"] = [rows[:, 2] for rows in seen.position.rows]
    return heights


def _idle(found: ProbeResult) -> ProbeAnswer:
    """Return how long episodes stand still before they begin."""
    waits: list[int] = []
    moving = list(_moving(found).values())
    if not moving:
        return unknown("idle start", "set", "no arm is known", "columns of joints or poses")
    for rows in zip(*moving, strict=True):
        speed = np.sum([np.linalg.norm(np.diff(one, axis=0), axis=1) for one in rows], axis=0)
        fast = float(np.quantile(speed, 0.95))
        begun = np.flatnonzero(speed > 0.1 * fast) if fast > 0 else np.array([len(speed)])
        waits.append(int(begun[0]) if len(begun) else len(speed))
    middle = int(np.median(waits))
    said = f"the arm stands still for {middle} steps in the middle of {len(waits)} episodes, for {max(waits)} at most"
    return ProbeAnswer("idle start", "set", middle, said)
