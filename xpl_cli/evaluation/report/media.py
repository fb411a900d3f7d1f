"""Films and curves of a report: embedded as far as a budget goes, linked beyond."""

from __future__ import annotations

import base64
import hashlib
import itertools
import json
from typing import TYPE_CHECKING, TypedDict

from xpl_cli.basics import files
from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.report import curves

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from xpl_cli.evaluation.records.model import EpisodeRecord, RecordedFile
    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.report.curves import Curves

TRACE, FILM = "trace", "film"
MEDIA_TYPES = {
    ".webp": "image/webp",
    ".gif": "image/gif",
    ".png": "image/png",
    ".mp4": "video/mp4",
    ".webm": "video/webm",
}


class Film(TypedDict):
    """Where a film is, and whether it is a video, or else a picture that moves."""

    source: str
    video: bool


class EpisodeMedia(TypedDict, total=False):
    """Media of an episode in the report.

    Attributes:
        film: its video.
        curves: its curves (`curves.read`).
        trace: address of the file with its curves, if they are not embedded.
        problem: a sentence, if a file is missing or was changed.
    """

    film: Film
    curves: Curves
    trace: str
    problem: str


def collect_media(run: Run, budget: int, link: str) -> dict[str, EpisodeMedia]:
    """Return the media of each episode that has a video or curves.

    Args:
        run: the run.
        budget: bytes that may be embedded.
        link: path from the page's folder to the run's, with a slash at the end unless it is empty.

    Returns:
        media by index of the episode.
    """
    media: dict[str, EpisodeMedia] = {}
    full: set[str] = set()
    for episode in _in_display_order(run):
        entry: EpisodeMedia = {}
        for kind, file in ((FILM, episode.film), (TRACE, episode.trace)):
            if file is None:
                continue
            try:
                path = locate(run.folder, file, kind)
                piece, size = (None, 0) if kind in full else _piece(kind, path, file, budget)
            except OSError as error:
                entry["problem"] = f"{file.path} cannot be read: {error.strerror}"
                continue
            except UserError as error:
                entry["problem"] = str(error)
                continue
            if piece is not None:
                budget -= size
            elif size:  # too large: the others of its kind are linked without reading them
                full.add(kind)
            entry |= piece or _link(kind, f"{link}{file.path}")
        if entry:
            media[str(episode.index)] = entry
    return media


def locate(folder: Path, file: RecordedFile, kind: str) -> Path:
    """Return where a film or curves of an episode lie.

    Raises:
        UserError: if the record names one outside the run's folder.
    """
    try:
        path: Path = (folder / file.path).resolve()
        is_inside = path.is_relative_to(folder.resolve())
    except (ValueError, RuntimeError, OSError):  # a name that no file bears, or a link that leads back to itself
        is_inside = False
    if not is_inside:
        raise UserError(f"the record names a {kind} outside the run: {file.path}")
    return path


def _piece(kind: str, path: Path, file: RecordedFile, budget: int) -> tuple[EpisodeMedia | None, int]:
    """Return a video or curves to embed, None if the budget is too small; and their size, 0 if not read."""
    if path.stat().st_size > budget:
        return None, 0
    content = files.read_regular(path)
    if hashlib.sha256(content).hexdigest() != file.digest:
        raise UserError(f"{file.path} is not what was recorded: its digest differs")
    if kind == TRACE:
        piece: EpisodeMedia = {"curves": curves.read(content, file.path)}
        size = len(json.dumps(piece))
    else:
        address = f"data:{_media_type(path)};base64,{base64.b64encode(content).decode()}"
        piece, size = _link(FILM, address), len(address)
    return None if size > budget else piece, size


def _link(kind: str, address: str) -> EpisodeMedia:
    if kind == TRACE:
        return {"trace": address}
    is_video = address.startswith("data:video/") or address.endswith((".mp4", ".webm"))
    return {"film": {"source": address, "video": is_video}}


def _media_type(path: Path) -> str:
    media_type = MEDIA_TYPES.get(path.suffix.lower())
    if media_type is None:
        raise UserError(f"{path.name} is no film: expected {', '.join(MEDIA_TYPES)}")
    return media_type


def _in_display_order(run: Run) -> Iterator[EpisodeRecord]:
    """Yield the episodes with a film or trace: of each cell in turn, and in each a failure and a success in turn."""
    cells: dict[tuple[str, str], tuple[list[EpisodeRecord], list[EpisodeRecord]]] = {}
    for episode in run.finals.values():
        if episode.trace is not None or episode.film is not None:
            cell = cells.setdefault(episode.cell_key, ([], []))
            cell[bool(episode.success)].append(episode)
    for row in itertools.zip_longest(*(_alternately(*cell) for cell in cells.values())):
        yield from filter(None, row)


def _alternately(first: list[EpisodeRecord], second: list[EpisodeRecord]) -> Iterator[EpisodeRecord]:
    for pair in itertools.zip_longest(first, second):
        yield from filter(None, pair)
