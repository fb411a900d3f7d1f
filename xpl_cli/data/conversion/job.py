"""The work of a conversion: episodes in several processes, each whole or not there, so that it goes on after a kill."""

from __future__ import annotations

import fcntl
import functools
import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import json_text
from xpl_cli.basics import parallel
from xpl_cli.basics.atomic import write_file
from xpl_cli.basics.errors import ExitCode
from xpl_cli.basics.sizes import told_size
from xpl_cli.data.conversion import mapping, sources
from xpl_cli.data.conversion.packing import NAME, PackedSet
from xpl_cli.data.conversion.renaming import RenamedEpisode, Renaming, plan_renaming
from xpl_cli.data.formats.writers import writer_of
from xpl_cli.data.formats.writing import CONVERTED, WriteOptions, WritePlan, WrittenEpisode
from xpl_cli.data.sets.delegating import base_format
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.summary import EpisodeSummary

if TYPE_CHECKING:
    from xpl_cli.basics.progress import Progress
    from xpl_cli.data.sets.interface import Demonstrations

_PLAN: Final = "plan.json"
_PIECES: Final = "pieces"
_TOLD_AGAIN_S: Final = 2.0
"""Seconds between two lines of progress."""


@dataclass(frozen=True)
class ConversionJob:
    """What is to be converted, and how.

    Attributes:
        source: the set.
        target: the file or folder that is made.
        to: the format.
        rate_hz: steps per second, where the set does not say them, or says wrong ones.
        robot: likewise what the robot is called.
        by: the mapping of the side that is not the standard's; None for none.
        written_by: the mapping of the result, where both sides are not.
        options: choices of the format.
        workers: processes; None for as many as there are cores.
    """

    source: Path
    target: Path
    to: str
    rate_hz: float | None = None
    robot: str | None = None
    by: str | None = None
    written_by: str | None = None
    options: WriteOptions = field(default_factory=WriteOptions)
    workers: int | None = None


@dataclass(frozen=True)
class ConversionReport:
    """What came of it.

    Attributes:
        source, target: paths.
        from_format, to_format: formats.
        episodes, steps: how many.
        resumed: episodes that were there from a run before.
        seconds: how long it took.
        size: bytes of the result.
        renamed: names that had to change, by the new one.
        lost: what is not in the result, and why.
        lossy: what is there, but not exactly, and how.
    """

    source: str
    target: str
    from_format: str
    to_format: str
    episodes: int
    steps: int
    resumed: int
    seconds: float
    size: int
    renamed: Mapping[str, str]
    lost: Mapping[str, str]
    lossy: Mapping[str, str]

    @property
    def data(self) -> dict[str, Any]:
        """The same as plain data."""
        return asdict(self)

    @property
    def text(self) -> str:
        """The same for people: what was made, and what is not as it was."""
        counts = f"{self.episodes} episodes, {self.steps} steps, {told_size(self.size)}"
        lines = [f"{self.target}: {self.to_format}, {counts}, from {self.from_format} in {self.seconds:.1f} s"]
        lines += [f"  renamed  {old} is {new}" for new, old in self.renamed.items()]
        lines += [f"  lossy    {name}: {how}" for name, how in self.lossy.items()]
        lines += [f"  lost     {name}: {why}" for name, why in self.lost.items()]
        return "\n".join(lines if len(lines) > 1 else [*lines, "  nothing is lost"])


def convert(job: ConversionJob, progress: Progress) -> ConversionReport:
    """Convert a set; what an earlier run of the same job has done is not done again.

    Raises:
        DataError: the set cannot be read, the format cannot hold it, or the target is there already.
    """
    begins = time.monotonic()
    if job.target.exists():
        raise DataError(f"{job.target} is there already", hint="remove it, or give another place", code=ExitCode.USAGE)
    source = sources.open_source(job.source, job.to, job.by, job.written_by)
    if not len(source):
        raise DataError(f"{job.source} has no episodes")
    plan, how = _make_plan(job, source)
    writer = writer_of(job.to)
    writer.check(plan)
    with _staging(job, plan) as staging:
        done = _written_indices(staging, len(plan.lengths))
        due = [index for index in range(len(plan.lengths)) if index not in done]
        if done:
            progress.step(f"{len(done)} of {len(plan.lengths)} episodes are there from a run before")
        task = _Task(job, plan, how, staging, os.getpid())
        _write_pending(task, due, progress, None if source.is_forkable else source)
        progress.step("joining the episodes")
        pieces = [_piece(staging, index) for index in range(len(plan.lengths))]
        made = writer.finish(staging, plan, pieces)
        made.rename(job.target)
        shutil.rmtree(staging)
    return ConversionReport(
        str(job.source),
        str(job.target),
        base_format(source),
        writer.name,
        len(plan.lengths),
        sum(plan.lengths),
        len(done),
        round(time.monotonic() - begins, 3),
        _size(job.target),
        how.changed,
        how.lost,
        _lossy(job, pieces),
    )


def _make_plan(job: ConversionJob, source: Demonstrations) -> tuple[WritePlan, Renaming]:
    """Return what is known of the set before its first episode is written."""
    rate = job.rate_hz or source.rate_hz
    writer = writer_of(job.to)
    how = plan_renaming(source, writer, rate, sources.mapped_names(job.to, job.by, job.written_by))
    first = RenamedEpisode(source[0], how)
    extras = {key: value for key, value in source.extras.items() if key != CONVERTED}
    numbers = [new for new, column in first.columns.items() if column.shape == ()]
    extras[CONVERTED] = {"from": source.format, "names": how.changed, "numbers": numbers}
    if isinstance(source, PackedSet):
        extras[CONVERTED][NAME] = source.layout
        extras[CONVERTED]["numbers"] += source.numbers
    listed = [EpisodeSummary.of(source[index]) for index in range(len(source))]
    plan = WritePlan(
        rate,
        job.robot or source.robot,
        tuple(episode.steps for episode in listed),
        tuple(episode.instructions for episode in listed),
        first.columns,
        first.cameras,
        extras,
        job.options,
    )
    return plan, how


@dataclass(frozen=True)
class _Task:
    """What a process of the pool needs to know.

    Attributes:
        job: what is converted.
        plan: what is known of the set.
        how: what is written, and under which names.
        staging: the folder of what is not finished.
        parent: the process that waits for it.
    """

    job: ConversionJob
    plan: WritePlan
    how: Renaming
    staging: Path
    parent: int


def _write_pending(task: _Task, due: list[int], progress: Progress, source: Demonstrations | None) -> None:
    """Write the pieces that are due: in several processes, or of a set that only this one may read here."""
    plan = task.plan
    begins = told = time.monotonic()
    steps = 0
    total = sum(plan.lengths[index] for index in due)
    if source is None:
        answers = parallel.in_processes(functools.partial(_write_in_worker, task), due, task.job.workers)
    else:
        answers = (_write(task, source, index) for index in due)
    for index, written in zip(due, answers, strict=True):
        if written is None:
            raise DataError(f"the process that converted the episode {index} died", hint="the same command goes on")
        steps += plan.lengths[index]
        now = time.monotonic()
        if now - told > _TOLD_AGAIN_S or index == due[-1]:
            rate = steps / max(now - begins, 1e-9)
            progress.step(
                f"{len(plan.lengths) - len(due) + due.index(index) + 1} of {len(plan.lengths)} episodes, "
                f"{rate:.0f} steps/s, {(total - steps) / rate:.0f} s to go"
            )
            told = now


def _write_in_worker(task: _Task, index: int) -> bool:
    """Write one episode, in a process of the pool."""
    parallel.die_with(task.parent)
    job = task.job
    return _write(task, _cached_source(job.source, job.to, job.by, job.written_by), index)


def _write(task: _Task, source: Demonstrations, index: int) -> bool:
    """Write one episode, and then the note that it is there."""
    episode = RenamedEpisode(source[index], task.how)
    told = writer_of(task.job.to).write_episode(task.staging, task.plan, index, episode)
    write_file(task.staging / _PIECES / f"{index:06d}.json", json.dumps(asdict(told)).encode())
    return True


@functools.lru_cache(maxsize=1)
def _cached_source(path: Path, to: str, by: str | None, written_by: str | None) -> Demonstrations:
    return sources.open_source(path, to, by, written_by)


@contextmanager
def _staging(job: ConversionJob, plan: WritePlan) -> Iterator[Path]:
    """Yield the folder of what is not finished, kept by this process alone; begun anew if it is of another job."""
    folder = job.target.parent / f".{job.target.name}.converting"
    folder.mkdir(parents=True, exist_ok=True)
    lock = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DataError(f"another process converts to {job.target} already") from None
        digest = _digest(job, plan)
        if _read_digest(folder / _PLAN) != digest:
            for entry in folder.iterdir():
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
            (folder / _PIECES).mkdir()
            write_file(folder / _PLAN, json.dumps({"digest": digest}).encode())
        yield folder
    finally:
        os.close(lock)


def _digest(job: ConversionJob, plan: WritePlan) -> str:
    """Return what tells one job from another: mappings by what they say, because a file may be mended meanwhile."""
    by = [mapping.digest(name) for name in (job.by, job.written_by) if name is not None]
    told: list[Any] = [str(job.source.resolve()), job.to, job.by, job.written_by, by, asdict(job.options)]
    told += [plan.rate_hz, plan.robot, plan.lengths, plan.instructions, list(plan.columns), list(plan.cameras)]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def _read_digest(path: Path) -> str | None:
    try:
        digest: str | None = json_text.parse(path.read_bytes()).get("digest")
    except (OSError, ValueError):
        return None
    return digest


def _written_indices(staging: Path, count: int) -> set[int]:
    return {index for index in range(count) if (staging / _PIECES / f"{index:06d}.json").is_file()}


def _piece(staging: Path, index: int) -> WrittenEpisode:
    return WrittenEpisode(**json_text.parse((staging / _PIECES / f"{index:06d}.json").read_bytes()))


def _lossy(job: ConversionJob, pieces: list[WrittenEpisode]) -> dict[str, str]:
    """Return what is not exactly what it was: images that were encoded here, with the worst that a sample shows."""
    worst: dict[str, float] = {}
    how: dict[str, str] = {}
    for piece in pieces:
        for name, value in piece.psnr_db.items():
            codec = piece.videos.get(name)
            how[name] = "encoded as JPEG" if codec is None else f"encoded as {codec}, crf {job.options.crf}"
            worst[name] = min(worst.get(name, value), value)
    return {name: f"{what}; PSNR {worst[name]:.1f} dB or more in samples" for name, what in how.items()}


def _size(path: Path) -> int:
    return (
        path.stat().st_size if path.is_file() else sum(one.stat().st_size for one in path.rglob("*") if one.is_file())
    )
