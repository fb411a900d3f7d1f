"""Runs the checks on a dataset, episode by episode, and returns a report like that of the audit."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import math
import os
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import _spec as sdk
from xpl_cli.audit.demonstrations.catalogue import CHECKS, find
from xpl_cli.audit.demonstrations.check import CameraFrames, DatasetInfo, EpisodeData
from xpl_cli.audit.rules.gates import DEMONSTRATIONS, DataGate
from xpl_cli.audit.rules.model import (
    Circumstances,
    Finding,
    GateReport,
    NotApplicable,
    Outcome,
    RuleResult,
    TargetReport,
    Waived,
    outcome_of,
)
from xpl_cli.basics import parallel
from xpl_cli.data.probe.probe import ProbeResult, probe
from xpl_cli.data.probe.sample import spread
from xpl_cli.data.reading import open_set
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from xpl_cli.audit.demonstrations.check import DemonstrationCheck
    from xpl_cli.data.sets.interface import Demonstrations, RecordedEpisode

_SMALL: Final = 40
"""Longest side of the downscaled first images, pixels."""
_PROBED: Final = 24
_MANY: Final = 24
"""Number of episodes from which all cores are used."""
_TOLD_AGAIN_S: Final = 2.0
"""Seconds between two lines of progress."""
_WIDEST: Final = 4096
"""Most numbers of a row that are read; of a larger column, such as an unnamed image, only the shape counts."""
_MOST_NUMBERS: Final = 1 << 24
"""Of one episode: two hours of an arm and its commands at 100 Hz take half of it."""


@dataclass(frozen=True)
class ValidationOptions:
    """What is checked.

    Attributes:
        episodes: how many, evenly spread; None for all.
        images: whether images are decoded.
        robot: name of the embodiment, where the user says it.
        names: codes, prefixes of codes, and slugs of the checks that run; empty for all.
        ignore: likewise of those that do not.
        waived: by code or slug why findings are accepted.
        progress: receives progress messages.
    """

    episodes: int | None = None
    images: bool = True
    robot: str | None = None
    names: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    waived: Mapping[str, str] = field(default_factory=dict)
    progress: Callable[[str], None] = lambda _: None


def select_checks(options: ValidationOptions) -> list[type[DemonstrationCheck]]:
    """Return the checks that run.

    Raises:
        UserError: if a name stands for no check.
    """
    for name in (*options.names, *options.ignore, *options.waived):
        if not any(_matches(check, name) for check in CHECKS):
            find(name)
    return [
        check
        for check in CHECKS
        if (not options.names or any(_matches(check, name) for name in options.names))
        and not any(_matches(check, name) for name in options.ignore)
        and (options.images or not check.needs_images)
    ]


def validate(demonstrations: Demonstrations, path: str, options: ValidationOptions) -> TargetReport:
    """Check a dataset.

    Args:
        demonstrations: the dataset.
        path: how reports name it.
        options: what is checked.
    """
    started = time.perf_counter()
    check_types = select_checks(options)
    indices = spread(len(demonstrations), options.episodes or len(demonstrations))
    checks = _make_checks(check_types, demonstrations, options)
    results: dict[str, RuleResult] = {}
    digest = hashlib.sha256()
    episodes_read = _read_episodes(demonstrations, indices, images=any(check.needs_images for check in checks))
    for episode in _report_progress(episodes_read, options, len(indices)):
        digest.update(repr((episode.key, episode.length, sorted(episode.shapes.items()))).encode())
        for check in checks:
            if check.code not in results:
                _run_step(results, check, partial(check.take, episode))
    for check in checks:
        if check.code not in results:
            _run_step(results, check, partial(_store_findings, results, check, options.waived))
    report = GateReport(DataGate.DATA, [results[check.code] for check in checks])
    report.digest = digest.hexdigest()[:16]
    report.fingerprint = "data"
    report.seconds = time.perf_counter() - started
    target = TargetReport(path=path, name=path.rstrip("/").rpartition("/")[2], kind=DEMONSTRATIONS, gates=[report])
    target.circumstances = Circumstances(narrowed=_describe_selection(len(indices), len(demonstrations), check_types))
    return target


def _read_episodes(demonstrations: Demonstrations, indices: Sequence[int], *, images: bool) -> Iterator[EpisodeData]:
    """Yield the data of episodes in order; of many with all cores, each process one episode at a time.

    Raises:
        DataError: a process died over one.
    """
    if len(indices) < _MANY or not demonstrations.is_forkable:
        yield from (_read_episode(demonstrations[index], images=images) for index in indices)
        return
    read = partial(_read_in_process, os.getpid(), Path(demonstrations.path), images)
    for index, seen in zip(indices, parallel.map_in_processes(read, indices), strict=True):
        if seen is None:
            raise DataError(f"the process that read the episode {index} died", hint="is there enough memory?")
        yield seen


def _read_in_process(parent: int, path: Path, images: bool, index: int) -> EpisodeData:  # noqa: FBT001 - of a partial
    """Read an episode, in a process of the pool."""
    parallel.end_with_parent(parent)
    return _read_episode(_open_cached(path)[index], images=images)


@functools.lru_cache(maxsize=1)
def _open_cached(path: Path) -> Demonstrations:
    return open_set(path)


def _report_progress(episodes: Iterator[EpisodeData], options: ValidationOptions, total: int) -> Iterator[EpisodeData]:
    """Yield episodes, and report progress every two seconds."""
    begins = last_report = time.monotonic()
    for count, episode in enumerate(episodes, 1):
        yield episode
        now = time.monotonic()
        if now - last_report > _TOLD_AGAIN_S:
            left = (now - begins) / count * (total - count)
            options.progress(f"episode {count} of {total}, {count / (now - begins):.1f} a second, {left:.0f} s to go")
            last_report = now


def _matches(check: type[DemonstrationCheck], name: str) -> bool:
    return check.slug == name or (name.upper().startswith("XPL") and check.code.startswith(name.upper()))


def _make_checks(
    chosen: Sequence[type[DemonstrationCheck]], demonstrations: Demonstrations, options: ValidationOptions
) -> list[DemonstrationCheck]:
    """Return the checks of a dataset, with the result of a probe."""
    from xpl.embodiment import embodiment_names

    robot = options.robot or (demonstrations.robot if demonstrations.robot in embodiment_names() else None)
    probe_result = ProbeResult([], [], [])
    if not any(check.needs_probe for check in chosen):
        return [check(DatasetInfo(demonstrations.format, robot, probe_result)) for check in chosen]
    options.progress("probing the columns")
    with contextlib.suppress(DataError, ValueError):  # the checks report where a dataset is damaged
        probe_result = probe(demonstrations, episodes=_PROBED, robot=robot, images=False)
    return [check(DatasetInfo(demonstrations.format, robot, probe_result)) for check in chosen]


def _store_findings(results: dict[str, RuleResult], check: DemonstrationCheck, waived: Mapping[str, str]) -> None:
    """Store the findings of a check."""
    results[check.code] = _make_result(check, list(check.findings()), waived)


def _run_step(results: dict[str, RuleResult], check: DemonstrationCheck, step: Callable[[], None]) -> None:
    """Run a step of a check; store the result if the check ends with it."""
    try:
        step()
    except NotApplicable as why:
        results[check.code] = _make_ended_result(check, Outcome.NOT_APPLICABLE, str(why))
    except Exception as error:  # noqa: BLE001 - a check's crash must not hide what the others find
        results[check.code] = _make_ended_result(check, Outcome.ERROR, f"{type(error).__name__}: {error}")


def _make_ended_result(check: DemonstrationCheck, outcome: Outcome, reason: str) -> RuleResult:
    return RuleResult(check.code, check.slug, check.requirement, check.severity, outcome, reason=reason)


def _make_result(check: DemonstrationCheck, findings: Sequence[Finding], waived: Mapping[str, str]) -> RuleResult:
    """Return the result of a check that got all episodes."""
    reason = next((why for name, why in waived.items() if _matches(type(check), name)), None)
    reported = () if reason is not None else tuple(findings)
    accepted = tuple(Waived(finding, reason) for finding in findings) if reason is not None else ()
    outcome = outcome_of(reported, check.severity)
    return RuleResult(check.code, check.slug, check.requirement, check.severity, outcome, reported, waived=accepted)


def _describe_selection(looked: int, count: int, chosen: Sequence[type[DemonstrationCheck]]) -> str:
    """Return what was left out, in a few words."""
    parts = [f"{looked} of {count} episodes"] if looked < count else []
    if len(chosen) < len(CHECKS):
        parts.append(f"{len(chosen)} of {len(CHECKS)} checks")
    return ", ".join(parts)


def _read_episode(episode: RecordedEpisode, *, images: bool) -> EpisodeData:
    """Read an episode: its numbers whole, its images one by one."""
    columns, shapes, errors = {}, {}, {}
    left = _MOST_NUMBERS
    for name, column in episode.columns.items():
        shapes[name] = tuple(column.shape)
        kind = np.dtype(column.dtype) if column.dtype not in {"object", "str", "string"} else None
        if kind is None or not (np.issubdtype(kind, np.number) or kind == np.bool_):
            continue
        if math.prod(column.shape) > _WIDEST:
            continue
        left -= episode.length * math.prod(column.shape)
        if left < 0:
            errors[name] = f"with it the columns of {episode.key} have more than {_MOST_NUMBERS} numbers"
            continue
        try:
            rows = np.asarray(episode.read(name))
        except (DataError, OSError, ValueError) as error:
            errors[name] = str(error)
            continue
        columns[name] = rows.astype(np.float64).reshape(len(rows), math.prod(column.shape))
    cameras = {
        name: _read_frames(episode, name)
        if images and camera.kind == sdk.Camera.COLOR
        else CameraFrames(None, None, None)
        for name, camera in episode.cameras.items()
    }
    return EpisodeData(episode.key, episode.length, tuple(episode.instructions), columns, shapes, cameras, errors)


def _read_frames(episode: RecordedEpisode, camera: str) -> CameraFrames:
    """Read the images of a camera, one by one."""
    count, first, last = 0, None, b""
    same: list[bool] = []
    try:
        for image in episode.frames(camera):
            digest = hashlib.blake2b(np.ascontiguousarray(image).data, digest_size=16).digest()
            if first is None:
                step = max(1, -(-max(image.shape[:2]) // _SMALL))
                first = np.array(image[::step, ::step])
            else:
                same.append(digest == last)
            count, last = count + 1, digest
    except (DataError, OSError, ValueError) as error:
        return CameraFrames(count, first, np.array(same, bool), str(error))
    return CameraFrames(count, first, np.array(same, bool))
