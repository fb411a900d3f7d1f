"""The order of episodes: that of the plan, without those that are final already."""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING

from xpl_cli.evaluation.records.cells import counts_as_success, retried_after_crash
from xpl_cli.evaluation.rollout.backend import RolloutJob

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from xpl_cli.evaluation.records.model import EpisodeRecord, PlannedEpisode
    from xpl_cli.evaluation.records.records import Run


class Schedule:
    """The episodes of a plan that are still to be run.

    An attempt with an infrastructure error, or in which the policy's process crashed, is retried after the other
    episodes of its cell: the cause may be gone by then.

    Args:
        run: the record.
        films: number of episodes of each cell with a video, from its first on.
        is_enough: returns whether a cell may end, given the successes of its episodes in the order of the plan, up to
            the first that is not final; None stands for an episode that does not count.
        traced: whether to record curves.
        judge: returns what counts instead of a final line's success.
    """

    def __init__(
        self,
        run: Run,
        films: int,
        is_enough: Callable[[Sequence[bool | None]], bool],
        *,
        traced: bool = True,
        judge: Callable[[EpisodeRecord], bool | None] | None = None,
    ) -> None:
        self._run = run
        self._traced = traced
        self._judge = judge or (lambda line: counts_as_success(line, self._retried_after_crash))
        self._is_enough = is_enough
        self._attempts = Counter(line.index for line in run.attempts)
        self._retried_after_crash = retried_after_crash(run.attempts)
        self._cells: list[list[PlannedEpisode]] = [[] for _ in run.plan.cells]
        for slot in run.plan.slots():
            self._cells[slot.cell].append(slot)
        self._filmed = {slot.index for cell in self._cells for slot in cell[:films]}
        self._waiting = [deque(slot for slot in cell if slot.index not in run.finals) for cell in self._cells]
        self._planned = {slot.index: slot for cell in self._cells for slot in cell}
        self._running: set[int] = set()
        for number in range(len(self._cells)):
            self._end_cell_if_due(number)

    @property
    def is_done(self) -> bool:
        """Whether no episode is running or waiting."""
        return not self._running and not any(self._waiting)

    @property
    def left(self) -> int:
        """Number of episodes that are not final yet, as far as is known."""
        return len(self._running) + sum(map(len, self._waiting))

    def next(self) -> RolloutJob | None:
        """Return the next job; None if none waits."""
        queue = next(filter(None, self._waiting), None)
        if queue is None:
            return None
        slot = queue.popleft()
        self._running.add(slot.index)
        attempt = self._attempts[slot.index] + 1
        is_filmed = slot.index in self._filmed
        return RolloutJob(slot.index, attempt, slot.task, slot.setting, slot.seed, trace=self._traced, film=is_filmed)

    def is_expected(self, job: RolloutJob) -> bool:
        """Return whether this attempt is running, as far as the schedule knows."""
        return job.index in self._running and job.attempt == self._attempts[job.index] + 1

    def add(self, line: EpisodeRecord) -> None:
        """Take note of an attempt that was recorded in the run."""
        slot = self._planned[line.index]
        self._running.discard(slot.index)
        self._attempts[slot.index] += 1
        self._retried_after_crash |= retried_after_crash([line])
        if not line.final:
            self._waiting[slot.cell].append(slot)
        self._end_cell_if_due(slot.cell)

    def _end_cell_if_due(self, number: int) -> None:
        """Let a cell end where that is due."""
        outcomes = []
        for slot in self._cells[number]:
            final = self._run.finals.get(slot.index)
            if final is None:
                break
            outcomes.append(self._judge(final))
        if self._is_enough(outcomes):
            self._waiting[number].clear()
