"""Run the episodes that a run lacks, and record them: exactly one final line for each episode.

Attempts and retries are decided here, for every backend. A result counts only if its attempt is expected; duplicates
and late results are dropped.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from xpl.vector import INFRASTRUCTURE
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records.failures import may_retry
from xpl_cli.evaluation.records.model import EpisodeRecord, RecordedFile
from xpl_cli.evaluation.records.records import RecordError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from xpl_cli.evaluation.records.fingerprints import Facts
    from xpl_cli.evaluation.records.model import RunPlan
    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.rollout.backend import Backend, RolloutJob, RolloutResult
    from xpl_cli.evaluation.runs.schedule import Schedule

TRACES, FILMS = "traces", "films"
_OUTAGE_FACTOR = 4
"""A run stops after this many times the attempts of one episode, all infrastructure errors in a row."""


class Sink(Protocol):
    """Stores the lines of a run: a record (`records.RecordWriter`), or memory (`records.InMemoryRecord`).

    Attributes:
        run: the content.
    """

    run: Run

    def machine(self, facts: Facts) -> str:
        """Return the digest of a machine's facts."""

    def add(self, line: EpisodeRecord) -> None:
        """Add one attempt at an episode."""


class ProgressView(Protocol):
    """Shows the progress of a run."""

    def add(self, line: EpisodeRecord, left: int) -> None:
        """Show a recorded line, and the number of episodes that are not final yet; may raise to end the run."""


def run_schedule(writer: Sink, backend: Backend, schedule: Schedule, view: ProgressView, *, ahead: bool = True) -> None:
    """Run until nothing is left.

    Args:
        writer: stores the lines.
        backend: runs the jobs.
        schedule: of the episodes.
        view: shows the progress.
        ahead: whether the next episode may begin before the last one is known not to be enough.

    Raises:
        UserError: nothing can run, or infrastructure errors do not end; what was recorded stays, and the run can be
            resumed.
    """
    attempts: int = writer.run.plan.control.attempts
    outage = _Outage(_OUTAGE_FACTOR * attempts)
    while not schedule.is_done:
        _submit(backend, schedule, outage)
        results = backend.wait()
        if ahead:
            _submit(backend, schedule, outage)  # workers continue while this process waits for the disk
        for result in results:
            if schedule.is_expected(result.job):
                line = _record(writer, result, attempts)
                schedule.add(line)
                view.add(line, schedule.left)
                outage.ended(result.job, line)
        if outage.is_lasting and not schedule.is_done:
            raise UserError(
                f"{outage.errors} attempts in a row ended with an infrastructure error, the last one: {outage.error}",
                hint="fix the cause and continue with --resume",
                code=ExitCode.NOT_RUN,
            )


def rerun_episodes(plan: RunPlan, jobs: Sequence[RolloutJob], backend: Backend) -> Iterator[EpisodeRecord]:
    """Run episodes and yield their lines, as they would be recorded but for machine and files; nothing is written."""
    waiting = list(reversed(jobs))
    running: set[RolloutJob] = set()
    while waiting or running:
        while waiting and backend.free() > 0:
            running.add(waiting[-1])
            backend.submit(waiting.pop())
        for result in backend.wait():
            if result.job in running:
                running.remove(result.job)
                yield _episode(plan, result, final=True)


def _submit(backend: Backend, schedule: Schedule, outage: _Outage) -> None:
    """Give jobs to all free workers, as far as there are some."""
    while backend.free() > 0 and (job := schedule.next()) is not None:
        outage.began(job)
        backend.submit(job)


class _Outage:
    """Infrastructure errors in a row; attempts that began before a later successful one do not count.

    Args:
        most: so many are an outage.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._open: dict[RolloutJob, int] = {}
        self._begun = self._sound = 0
        self.errors, self.error = 0, ""

    @property
    def is_lasting(self) -> bool:
        """Whether there is no sense in going on."""
        return self.errors >= self._most

    def began(self, job: RolloutJob) -> None:
        """Note that an attempt begins."""
        self._begun += 1
        self._open[job] = self._begun

    def ended(self, job: RolloutJob, line: EpisodeRecord) -> None:
        """Note how an attempt ended."""
        begun = self._open.pop(job)
        if line.failure != INFRASTRUCTURE:
            self._sound, self.errors = self._begun, 0
        elif begun > self._sound:
            self.errors, self.error = self.errors + 1, str(line.error)


def _record(writer: Sink, result: RolloutResult, attempts: int) -> EpisodeRecord:
    """Write an attempt down, its files first, and return its line."""
    job, plan, folder = result.job, writer.run.plan, writer.run.folder
    episode = replace(
        _episode(plan, result, final=not may_retry(result.outcome) or job.attempt >= attempts),
        machine=writer.machine(result.facts),
        trace=_write_file(folder, f"{TRACES}/{job.index}.npz", result.trace),
        film=_write_file(folder, f"{FILMS}/{job.index}.webp", result.film),
    )
    writer.add(episode)
    return episode


def _episode(plan: RunPlan, result: RolloutResult, *, final: bool) -> EpisodeRecord:
    """Return an attempt as it is recorded, but for machine and files."""
    job = result.job
    return EpisodeRecord(
        index=job.index,
        attempt=job.attempt,
        final=final,
        task=job.task,
        setting=job.setting,
        seed=job.seed,
        embodiment=plan.embodiment,
        action_type=plan.action_type,
        machine="",
        **vars(result.outcome),
        **vars(result.execution),
    )


def _write_file(folder: Path, name: str, content: bytes | None) -> RecordedFile | None:
    """Write a file of a run, if there is content, and return its entry in the record."""
    if content is None:
        return None
    path = folder / name
    if path.parent.is_symlink():  # a run that others began may hold one to anywhere
        raise RecordError(f"{path} cannot be written: expected {path.parent.name} to be a folder, got a link")
    try:
        path.parent.mkdir(exist_ok=True)
        atomic.write_file(path, content)
    except OSError as error:
        raise RecordError(f"{path} cannot be written: {error.strerror or error}") from None
    return RecordedFile(name, hashlib.sha256(content).hexdigest())
