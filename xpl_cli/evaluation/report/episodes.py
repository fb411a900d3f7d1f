"""The episodes of a run, as the page's list, as a table for spreadsheets, and one by one."""

from __future__ import annotations

import csv
import io
import json
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.basics.untrusted import in_table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.evaluation.records.model import EpisodeRecord
    from xpl_cli.evaluation.records.records import Run

SUCCESS, NOT_JUDGED = "success", "not judged"

_PLAIN = ("index", sdk.Deploy.SEED, "score", "steps")
_SHARED = (
    "task",
    "setting",
    sdk.Obs.INSTRUCTION,
    "stages",
    "end_reason",
    "error",
    "corrections",
    "safety",
    "server",
    "worker",
)
_COLUMNS = (
    *("index", "task", "setting", sdk.Deploy.SEED, "outcome", "success", "score", "steps", "end_reason", "attempt"),
    *("wall_seconds", "inference_count", "inference_seconds", sdk.Obs.INSTRUCTION, "error", "digest", "started"),
    *("trace", "film"),
)
_DIGEST_SHOWN = 12


def verdict(episode: EpisodeRecord) -> str:
    """Return how an episode ended: success, a class of failure, or not judged."""
    if episode.failure is not None:
        return episode.failure
    return SUCCESS if episode.success else NOT_JUDGED


def inference_seconds(episode: EpisodeRecord) -> float | None:
    """Return the mean round trip of get_action, None where there was none."""
    inference = episode.inference
    return inference.seconds / inference.count if inference and inference.count else None


def packed(run: Run) -> dict[str, Any]:
    """Return the final episodes by column; repeated texts are stored once.

    Returns:
        `values`: texts and objects; `columns`: numbers as they are, and for the names in `shared`, indices of `values`;
        `earlier`: index of the error of each earlier attempt, by episode.
    """
    pool = _Pool()
    finals = run.finals.values()
    columns: dict[str, Sequence[object]] = {name: [getattr(episode, name) for episode in finals] for name in _PLAIN}
    columns |= {name: [pool.index_of(getattr(episode, name)) for episode in finals] for name in _SHARED}
    columns["outcome"] = [pool.index_of(verdict(episode)) for episode in finals]
    columns["attempt"] = [episode.attempt for episode in finals]
    columns["seconds"] = [round(episode.wall_seconds, 2) for episode in finals]
    columns["ms"] = [_milliseconds(episode) for episode in finals]
    columns["digest"] = [(episode.digest or "")[:_DIGEST_SHOWN] for episode in finals]
    earlier: dict[str, list[int]] = {}
    for episode in run.attempts:
        if not episode.final:
            earlier.setdefault(str(episode.index), []).append(pool.index_of(episode.error))
    return {"values": pool.values, "shared": [*_SHARED, "outcome"], "columns": columns, "earlier": earlier}


def table(run: Run) -> str:
    """Return the final episodes as CSV with a line for each."""
    return as_csv(_COLUMNS, (_row(episode) for episode in run.finals.values()))


def as_csv(header: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table as CSV; what a spreadsheet would take for a formula is made a text."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerows([in_table(value) for value in row] for row in (header, *rows))
    return buffer.getvalue()


class _Pool:
    """Values, each stored once."""

    def __init__(self) -> None:
        self.values: list[object] = []
        self._indices: dict[str, int] = {}

    def index_of(self, value: object) -> int:
        key = value if isinstance(value, str) else json.dumps(value)
        index = self._indices.setdefault(f"{type(value).__name__} {key}", len(self.values))
        if index == len(self.values):
            self.values.append(value)
        return index


def _milliseconds(episode: EpisodeRecord) -> float | None:
    seconds = inference_seconds(episode)
    return None if seconds is None else round(1000 * seconds, 2)


def _row(episode: EpisodeRecord) -> list[object]:
    """Return the values of a line of the table."""
    success, inference = episode.success, episode.inference
    values = {
        **vars(episode),
        "outcome": verdict(episode),
        "success": None if success is None else int(success),
        "inference_count": None if inference is None else inference.count,
        "inference_seconds": None if inference is None else inference.seconds,
        "trace": None if episode.trace is None else episode.trace.path,
        "film": None if episode.film is None else episode.film.path,
    }
    return [values[name] for name in _COLUMNS]
