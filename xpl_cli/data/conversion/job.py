"""A conversion job: episodes are written in several processes, each atomically, so that a killed job resumes."""

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
from xpl_cli.basics.sizes import format_size
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
_REPORT_INTERVAL_S: Final = 2.0
"""Seconds between two lines of progress."""


@dataclass(frozen=True)
class ConversionJob:
    """What to convert, and how.

    Attributes:
        source: path of the dataset.
        target: path of the output file or folder.
        to: name of the output format.
        rate_hz: steps per second, where the dataset has none, or a wrong value.
        robot: likewise the robot's name.
        by: mapping of the side that is not in the standard's format; None for none.
        written_by: mapping of the output, where neither side is in the standard's format.
        options: of the output format.
        workers: number of processes; None for the number of cores.
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
    """The result of a conversion.

    Attributes:
        source, target: paths.
        from_format, to_format: formats.
        episodes, steps: counts.
        resumed: episodes that an earlier run had written.
        seconds: duration.
        size: of the output, bytes.
        renamed: the old name of each renamed column and camera, by the new one.
        lost: why a column or camera is not in the output, by name.
        lossy: how a camera's images differ from the source, by name.
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
        """The report as JSON values."""
        return asdict(self)

    @property
    def text(self) -> str:
        """The report as text: what was written, and what was lost."""
        counts = f"{self.episodes} episodes, {self.steps} steps, {format_size(self.size)}"
        lines = [f"{self.target}: {self.to_format}, {counts}, from {self.from_format} in {self.seconds:.1f} s"]
        lines += [f"  renamed  {old} is {new}" for new, old in self.renamed.items()]
        lines += [f"  lossy    {name}: {how}" for name, how in self.lossy.items()]
        lines += [f"  lost     {name}: {why}" for name, why in self.lost.items()]
        return "\n".join(lines if len(lines) > 1 else [*lines, "  nothing is lost"])


def convert(job: ConversionJob, progress: Progress) -> ConversionReport:
    """Convert a dataset; episodes that an earlier run of the same job wrote are kept.

    Raises:
        DataError: the dataset cannot be read, the format cannot hold it, or the target exists.
    """
    begins = time.monotonic()
    if job.target.exists():
        raise DataError(f"{job.target} exists already", hint="remove it, or choose another target", code=ExitCode.USAGE)
    source = sources.open_source(job.source, job.to, job.by, job.written_by)
    if not len(source):
        raise DataError(f"{job.source} has no episodes")
    plan, how = _make_plan(job, source)
    writer = writer_of(job.to)
    writer.check(plan)
    with _staging(job, plan) as staging:
        finished = _written_indices(staging, len(plan.lengths))
        due = [index for index in range(len(plan.lengths)) if index not in finished]
        if finished:
            progress.step(f"{len(finished)} of {len(plan.lengths)} episodes were written by an earlier run")
        task = _Task(job, plan, how, staging, os.getpid())
        _write_pending(task, due, progress, None if source.is_forkable else source)
        progress.step("joining the episodes")
        pieces = [_piece(staging, index) for index in range(len(plan.lengths))]
        result = writer.finish(staging, plan, pieces)
        result.rename(job.target)
        shutil.rmtree(staging)
    return ConversionReport(
        str(job.source),
        str(job.target),
        base_format(source),
        writer.name,
        len(plan.lengths),
        sum(plan.lengths),
        len(finished),
        round(time.monotonic() - begins, 3),
        _size(job.target),
        how.changed,
        how.lost,
        _lossy(job, pieces),
    )


def _make_plan(job: ConversionJob, source: Demonstrations) -> tuple[WritePlan, Renaming]:
    """Return the plan and the names, before the first episode is written."""
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
    summaries = [EpisodeSummary.of(source[index]) for index in range(len(source))]
    plan = WritePlan(
        rate,
        job.robot or source.robot,
        tuple(episode.steps for episode in summaries),
        tuple(episode.instructions for episode in summaries),
        first.columns,
        first.cameras,
        extras,
        job.options,
    )
    return plan, how


@dataclass(frozen=True)
class _Task:
    """What a worker process of the pool needs.

    Attributes:
        job: the conversion.
        plan: facts of the whole dataset.
        how: the columns and cameras that are written, and their names.
        staging: folder of the unfinished output.
        parent: process id of the process that waits for the pool.
    """

    job: ConversionJob
    plan: WritePlan
    how: Renaming
    staging: Path
    parent: int


def _write_pending(task: _Task, due: list[int], progress: Progress, source: Demonstrations | None) -> None:
    """Write the pending episodes: in worker processes, or in this one where the dataset is not forkable."""
    plan = task.plan
    begins = last_report = time.monotonic()
    steps = 0
    total = sum(plan.lengths[index] for index in due)
    if source is None:
        answers = parallel.map_in_processes(functools.partial(_write_in_worker, task), due, task.job.workers)
    else:
        answers = (_write(task, source, index) for index in due)
    for index, written in zip(due, answers, strict=True):
        if written is None:
            raise DataError(f"the process that converted the episode {index} died", hint="the same command resumes")
        steps += plan.lengths[index]
        now = time.monotonic()
        if now - last_report > _REPORT_INTERVAL_S or index == due[-1]:
            rate = steps / max(now - begins, 1e-9)
            progress.step(
                f"{len(plan.lengths) - len(due) + due.index(index) + 1} of {len(plan.lengths)} episodes, "
                f"{rate:.0f} steps/s, {(total - steps) / rate:.0f} s left"
            )
            last_report = now


def _write_in_worker(task: _Task, index: int) -> bool:
    """Write one episode, in a worker process of the pool."""
    parallel.end_with_parent(task.parent)
    job = task.job
    return _write(task, _cached_source(job.source, job.to, job.by, job.written_by), index)


def _write(task: _Task, source: Demonstrations, index: int) -> bool:
    """Write one episode, then the file that marks it as written."""
    episode = RenamedEpisode(source[index], task.how)
    written = writer_of(task.job.to).write_episode(task.staging, task.plan, index, episode)
    write_file(task.staging / _PIECES / f"{index:06d}.json", json.dumps(asdict(written)).encode())
    return True


@functools.lru_cache(maxsize=1)
def _cached_source(path: Path, to: str, by: str | None, written_by: str | None) -> Demonstrations:
    return sources.open_source(path, to, by, written_by)


@contextmanager
def _staging(job: ConversionJob, plan: WritePlan) -> Iterator[Path]:
    """Lock and yield the staging folder; empty it first if it belongs to another job."""
    folder = job.target.parent / f".{job.target.name}.converting"
    folder.mkdir(parents=True, exist_ok=True)
    lock = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DataError(f"another process is converting to {job.target}") from None
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
    """Return the digest of a job, with the content of its mappings, because a file may change between runs."""
    by = [mapping.digest(name) for name in (job.by, job.written_by) if name is not None]
    inputs: list[Any] = [str(job.source.resolve()), job.to, job.by, job.written_by, by, asdict(job.options)]
    inputs += [plan.rate_hz, plan.robot, plan.lengths, plan.instructions, list(plan.columns), list(plan.cameras)]
    return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()


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
    """Return how images were encoded lossily, with the lowest PSNR of the sampled frames."""
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
