"""Checks of every dataset: schema, time, non-finite numbers, copied actions, constants, language."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from xpl_cli.audit.demonstrations.check import DatasetInfo, DemonstrationCheck, EpisodeData, EpisodeTally
from xpl_cli.audit.rules.model import Finding, NotApplicable
from xpl_cli.data.probe.sample import COMMAND, STATE, is_clock, role_of

if TYPE_CHECKING:
    from collections.abc import Iterator

_GAP: Final = 1.8
"""How many times the usual step a step in time may be."""


class EpisodeSchema(DemonstrationCheck):
    """Every episode has the columns and cameras of the others, in the same shapes.

    ## What it does
    Compares columns, shapes of rows, and cameras of each episode with those that most episodes have; looks for episodes
    without steps, columns that cannot be read, and columns of another length than the episode.

    ## Why it matters
    A loader takes the schema of the first episode for all. A column that another episode lacks ends training hours
    later, or is silently left out.

    ## Example
    `observation.state` has 14 numbers in 49 episodes and 13 in one.

    ## Use instead
    Record the episode again, or leave it out when you convert.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL701", "demonstrations-schema", "must"

    def __init__(self, dataset: DatasetInfo) -> None:
        super().__init__(dataset)
        self._shapes: dict[tuple[str, tuple[int, ...]], list[str]] = {}
        self._cameras: dict[str, list[str]] = {}
        self._keys: list[str] = []

    def inspect(self, episode: EpisodeData) -> None:
        """Record its columns."""
        self._keys.append(episode.key)
        if not episode.length:
            self.tally.add("an episode has no steps", episode.key)
        for name, shape in episode.shapes.items():
            self._shapes.setdefault((name, shape), []).append(episode.key)
        for name in episode.cameras:
            self._cameras.setdefault(name, []).append(episode.key)
        for name, rows in episode.columns.items():
            if len(rows) != episode.length:
                self.tally.add(f"{name} has another length than its episode", f"{episode.key} ({len(rows)} rows)")
        for name, why in episode.errors.items():
            self.tally.add(f"{name} cannot be read ({why})", episode.key)

    def findings(self) -> Iterator[Finding]:
        """Yield what differs from most episodes."""
        if not self._keys:
            yield Finding("the dataset has no episodes", expected="at least one")
        for name in dict.fromkeys(name for name, _ in self._shapes):
            shapes = {shape: keys for (other, shape), keys in self._shapes.items() if other == name}
            usual = max(shapes, key=lambda shape: len(shapes[shape]))
            for shape, keys in shapes.items():
                for key in keys if shape != usual else ():
                    self.tally.add(f"a row of {name} has the shape {list(shape)}, where others have {list(usual)}", key)
            self._missing("column", name, {key for keys in shapes.values() for key in keys})
        for name, keys in self._cameras.items():
            self._missing("camera", name, set(keys))
        yield from self.tally.findings()

    def _missing(self, what: str, name: str, having: set[str]) -> None:
        missing = [key for key in self._keys if key not in having]
        if missing and len(having) >= len(missing):
            for key in missing:
                self.tally.add(f"the {what} {name} is missing", key)
        elif missing:
            for key in sorted(having):
                self.tally.add(f"the {what} {name} is there, which others lack", key)


class TimeGaps(DemonstrationCheck):
    """Timestamps increase evenly: no step back, no gap.

    ## What it does
    Reads columns of timestamps. A step that does not increase fails; a step of more than 1.8 times the median warns.

    ## Why it matters
    A policy is trained as if each row came one control step after the other. Where a recorder lost rows, the robot
    seems to jump, and action chunks cover more time than they should.

    ## Example
    `timestamp` increases by 0.033 s, and once by 0.4 s.

    ## Use instead
    Cut the episode at the gap, or record it again.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL702", "time-gaps", "must"

    def __init__(self, dataset: DatasetInfo) -> None:
        super().__init__(dataset)
        self._gaps = EpisodeTally()
        self._clocks = 0

    def inspect(self, episode: EpisodeData) -> None:
        """Inspect its timestamps."""
        for name, rows in episode.columns.items():
            if not is_clock(name) or rows.shape[1] != 1 or len(rows) < 3:
                continue
            self._clocks += 1
            steps = np.diff(rows[:, 0])
            usual = float(np.median(steps))
            back = np.flatnonzero(steps <= 0)
            if len(back):
                self.tally.add(f"{name} does not increase", f"{episode.key} (step {back[0] + 1})")
            wide = np.flatnonzero(steps > _GAP * usual) if usual > 0 else np.zeros(0, int)
            if len(wide):
                times = f"{steps[wide].max() / usual:.1f} times the usual step"
                self._gaps.add(f"{name} has gaps", f"{episode.key} (step {wide[0] + 1}, {times})")

    def findings(self) -> Iterator[Finding]:
        """Yield decreasing timestamps, which fail, and gaps, which warn."""
        if not self._clocks:
            raise NotApplicable("no column holds timestamps")
        yield from self.tally.findings()
        self._gaps.episodes = self.tally.episodes
        yield from self._gaps.findings(must=False)


class FiniteNumbers(DemonstrationCheck):
    """Every number is finite: no NaN, no infinity.

    ## What it does
    Checks every number of states and commands.

    ## Why it matters
    One NaN makes a loss NaN, and from then on every weight.

    ## Example
    The wrist's force is NaN until the sensor has started.

    ## Use instead
    Cut the rows, or leave the column out.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL706", "not-finite", "must"

    def inspect(self, episode: EpisodeData) -> None:
        """Check its numbers."""
        for name, rows in episode.columns.items():
            wrong = np.flatnonzero(~np.isfinite(rows).all(1))
            if len(wrong):
                self.tally.add(f"{name} holds numbers that are not finite", f"{episode.key} (step {wrong[0]})")


class ActionIsState(DemonstrationCheck):
    """Actions are not a copy of the state of their own step.

    ## What it does
    Compares columns of commands with columns of the state, number by number, in the same row.

    ## Why it matters
    From a copy, a policy learns to stay where it is. Recorders without access to commands write the measured joints
    twice; then the next state is the best substitute for a command.

    ## Example
    `action` equals `observation.state` in every row.

    ## Use instead
    Record the commands; without them take the state of a later step, and document it.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL710", "action-is-state", "must"

    def inspect(self, episode: EpisodeData) -> None:
        """Compare its commands."""
        states = {name: rows for name, rows in episode.columns.items() if role_of(name) == STATE}
        for name, rows in episode.columns.items():
            if role_of(name) != COMMAND or len(rows) < 3:
                continue
            for other, state_rows in states.items():
                if state_rows.shape != rows.shape:
                    continue
                moves = np.ptp(state_rows, axis=0) > 1e-6
                same = np.abs(rows - state_rows) <= 1e-6 * np.maximum(np.ptp(state_rows, axis=0), 1e-3)
                if moves.sum() >= min(3, rows.shape[1]) and same[:, moves].mean() > 0.99:
                    self.tally.add(f"{name} is a copy of {other} in the same step", episode.key)


class Instructions(DemonstrationCheck):
    """Every episode has an instruction.

    ## What it does
    Finds episodes without an instruction, or with a blank one.

    ## Why it matters
    From these, a language-conditioned policy learns to ignore the instruction.

    ## Example
    Three episodes of `stack_blocks` have no instruction.

    ## Use instead
    Add the instruction; waive this for datasets of policies that read no language.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL711", "no-instruction", "should"

    def inspect(self, episode: EpisodeData) -> None:
        """Check its instructions."""
        if not any(sentence.strip() for sentence in episode.instructions):
            self.tally.add("the episode has no instruction", episode.key)


class ConstantNumbers(DemonstrationCheck):
    """Numbers vary: no state or command is constant in all episodes while others of its column move.

    ## What it does
    Finds numbers of states and commands that are equal in every row of every episode.

    ## Why it matters
    A joint that never moves while its neighbours do is a sensor that is not read, or a column that was filled with
    zeros. Normalisation divides by its range, which is zero.

    ## Example
    The fifth number of `observation.state` is 0 in all rows.

    ## Use instead
    Repair the recorder; if the number is constant on purpose, waive this, and state how it is normalised.

    ## Fix safety
    No automatic fix.
    """

    code, slug, severity = "XPL714", "constant-numbers", "should"

    def __init__(self, dataset: DatasetInfo) -> None:
        super().__init__(dataset)
        self._low: dict[str, np.ndarray] = {}
        self._high: dict[str, np.ndarray] = {}

    def inspect(self, episode: EpisodeData) -> None:
        """Record its ranges."""
        for name, rows in episode.columns.items():
            if role_of(name) not in {STATE, COMMAND} or not len(rows) or not np.isfinite(rows).all():
                continue
            low, high = rows.min(0), rows.max(0)
            if name in self._low and self._low[name].shape == low.shape:
                low, high = np.minimum(low, self._low[name]), np.maximum(high, self._high[name])
            self._low[name], self._high[name] = low, high

    def findings(self) -> Iterator[Finding]:
        """Yield numbers that never change, of columns in which others do."""
        for name, low in self._low.items():
            still = np.abs(self._high[name] - low) <= 1e-9
            if still.any() and not still.all():
                indices = ", ".join(map(str, np.flatnonzero(still)))
                values = ", ".join(f"{value:.4g}" for value in low[still][:4])
                yield Finding(f"in {name} number {indices} never changes", got=values)
            elif still.all() and len(still) > 2:
                yield Finding(f"{name} never changes", got=", ".join(f"{value:.4g}" for value in low[:4]))
