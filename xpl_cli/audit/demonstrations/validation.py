"""Runs the checks on a set, episode after episode, and reports as the audit does."""

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
from xpl_cli.audit.demonstrations.check import About, Seen, Shown
from xpl_cli.audit.rules.gates import DEMONSTRATIONS, DataGate
from xpl_cli.audit.rules.model import (
    Circumstances,
    Finding,
    GateReport,
    NotApplicable,
    Outcome,
    Result,
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

    from xpl_cli.audit.demonstrations.check import Check
    from xpl_cli.data.sets.interface import Demonstrations, RecordedEpisode

_SMALL: Final = 40
"""Pixels that first images are made smaller to."""
_PROBED: Final = 24
_MANY: Final = 24
"""Episodes from which on all cores work."""
_TOLD_AGAIN_S: Final = 2.0
"""Seconds between two lines of progress."""
_WIDEST: Final = 4096
"""Numbers of a row that are still looked at: more is a picture by another name, of which only the form is."""
_MOST_NUMBERS: Final = 1 << 24
"""Of one episode: two hours of an arm and its commands at 100 Hz are half of it."""


@dataclass(frozen=True)
class Options:
    """What is checked.

    Attributes:
        episodes: how many, evenly spread; None for all.
        images: whether images are decoded.
        robot: name of the embodiment, where the user says it.
        names: codes, their beginnings, and slugs of the checks that run; empty for all.
        ignore: likewise of those that do not.
        waived: by code or slug why findings are accepted.
        told: is told what is going on.
    """

    episodes: int | None = None
    images: bool = True
    robot: str | None = None
    names: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    waived: Mapping[str, str] = field(default_factory=dict)
    told: Callable[[str], None] = lambda _: None


def selected(options: Options) -> list[type[Check]]:
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
        and (options.images or not check.looks)
    ]


def validate(demonstrations: Demonstrations, shown: str, options: Options) -> TargetReport:
    """Check a set.

    Args:
        demonstrations: the set.
        shown: how reports name it.
        options: what is checked.
    """
    started = time.perf_counter()
    chosen = selected(options)
    places = spread(len(demonstrations), options.episodes or len(demonstrations))
    checks = _made(chosen, demonstrations, options)
    results: dict[str, Result] = {}
    digest = hashlib.sha256()
    looked = _looked(demonstrations, places, images=any(check.looks for check in checks))
    for episode in _watched(looked, options, len(places)):
        digest.update(repr((episode.key, episode.length, sorted(episode.shapes.items()))).encode())
        for check in checks:
            if check.code not in results:
                _ask(results, check, partial(check.take, episode))
    for check in checks:
        if check.code not in results:
            _ask(results, check, partial(_close, results, check, options.waived))
    report = GateReport(DataGate.DATA, [results[check.code] for check in checks])
    report.digest = digest.hexdigest()[:16]
    report.fingerprint = "data"
    report.seconds = time.perf_counter() - started
    target = TargetReport(path=shown, name=shown.rstrip("/").rpartition("/")[2], kind=DEMONSTRATIONS, gates=[report])
    target.circumstances = Circumstances(narrowed=_narrowed(len(places), len(demonstrations), chosen))
    return target


def _looked(demonstrations: Demonstrations, places: Sequence[int], *, images: bool) -> Iterator[Seen]:
    """Yield what is seen of episodes, in their order; of many with all cores, each process one episode at a time.

    Raises:
        DataError: a process died over one.
    """
    if len(places) < _MANY or not demonstrations.is_forkable:
        yield from (_seen(demonstrations[place], images=images) for place in places)
        return
    look = partial(_seen_in, os.getpid(), Path(demonstrations.path), images)
    for place, seen in zip(places, parallel.in_processes(look, places), strict=True):
        if seen is None:
            raise DataError(f"the process that read the episode {place} died", hint="is there memory enough for it?")
        yield seen


def _seen_in(parent: int, path: Path, images: bool, place: int) -> Seen:  # noqa: FBT001 - of a partial
    """Read an episode, in a process of the pool."""
    parallel.die_with(parent)
    return _seen(_opened(path)[place], images=images)


@functools.lru_cache(maxsize=1)
def _opened(path: Path) -> Demonstrations:
    return open_set(path)


def _watched(episodes: Iterator[Seen], options: Options, total: int) -> Iterator[Seen]:
    """Yield episodes, and tell now and then how far it is."""
    begins = told = time.monotonic()
    for count, episode in enumerate(episodes, 1):
        yield episode
        now = time.monotonic()
        if now - told > _TOLD_AGAIN_S:
            left = (now - begins) / count * (total - count)
            options.told(f"episode {count} of {total}, {count / (now - begins):.1f} a second, {left:.0f} s to go")
            told = now


def _matches(check: type[Check], name: str) -> bool:
    return check.slug == name or (name.upper().startswith("XPL") and check.code.startswith(name.upper()))


def _made(chosen: Sequence[type[Check]], demonstrations: Demonstrations, options: Options) -> list[Check]:
    """Return the checks of a set, which know what a probe finds in it."""
    from xpl.embodiment import embodiment_names

    robot = options.robot or (demonstrations.robot if demonstrations.robot in embodiment_names() else None)
    found = ProbeResult([], [], [])
    if not any(check.measures for check in chosen):
        return [check(About(demonstrations.format, robot, found)) for check in chosen]
    options.told("which numbers are what")
    with contextlib.suppress(DataError, ValueError):  # of a set that is damaged the checks say where
        found = probe(demonstrations, episodes=_PROBED, robot=robot, images=False)
    return [check(About(demonstrations.format, robot, found)) for check in chosen]


def _close(results: dict[str, Result], check: Check, waived: Mapping[str, str]) -> None:
    """Note what a check found."""
    results[check.code] = _result(check, list(check.findings()), waived)


def _ask(results: dict[str, Result], check: Check, step: Callable[[], None]) -> None:
    """Let a check take a step; note how it ends where it does not go on."""
    try:
        step()
    except NotApplicable as why:
        results[check.code] = _ended(check, Outcome.NOT_APPLICABLE, str(why))
    except Exception as error:  # noqa: BLE001 - a check's crash must not hide what the others find
        results[check.code] = _ended(check, Outcome.ERROR, f"{type(error).__name__}: {error}")


def _ended(check: Check, outcome: Outcome, reason: str) -> Result:
    return Result(check.code, check.slug, check.requirement, check.severity, outcome, reason=reason)


def _result(check: Check, found: Sequence[Finding], waived: Mapping[str, str]) -> Result:
    """Return the result of a check that saw all episodes."""
    reason = next((why for name, why in waived.items() if _matches(type(check), name)), None)
    kept = () if reason is not None else tuple(found)
    accepted = tuple(Waived(finding, reason) for finding in found) if reason is not None else ()
    outcome = outcome_of(kept, check.severity)
    return Result(check.code, check.slug, check.requirement, check.severity, outcome, kept, waived=accepted)


def _narrowed(looked: int, count: int, chosen: Sequence[type[Check]]) -> str:
    """Return what was left out, in a few words."""
    parts = [f"{looked} of {count} episodes"] if looked < count else []
    if len(chosen) < len(CHECKS):
        parts.append(f"{len(chosen)} of {len(CHECKS)} checks")
    return ", ".join(parts)


def _seen(episode: RecordedEpisode, *, images: bool) -> Seen:
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
        name: _shown(episode, name) if images and camera.kind == sdk.Camera.COLOR else Shown(None, None, None)
        for name, camera in episode.cameras.items()
    }
    return Seen(episode.key, episode.length, tuple(episode.instructions), columns, shapes, cameras, errors)


def _shown(episode: RecordedEpisode, camera: str) -> Shown:
    """Look at the images of a camera, one by one."""
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
        return Shown(count, first, np.array(same, bool), str(error))
    return Shown(count, first, np.array(same, bool))
