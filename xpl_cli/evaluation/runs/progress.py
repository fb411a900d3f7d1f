"""How far a run has come: a table that changes on a terminal, a line for each episode elsewhere; all on stderr."""

from __future__ import annotations

import contextlib
import sys
import time
from collections import Counter
from typing import TYPE_CHECKING

from xpl_cli.basics import console
from xpl_cli.basics.untrusted import one_line
from xpl_cli.evaluation.statistics import wording
from xpl_cli.evaluation.statistics.intervals import wilson

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import RenderableType
    from rich.live import Live

    from xpl_cli.evaluation.records.model import EpisodeRecord
    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.runs.runner import ProgressView

_HOUR_S = 3600.0
_CELLS = 16
"""Most cells in the terminal's table; running ones are among them."""


@contextlib.contextmanager
def show_progress(run: Run, left: int) -> Iterator[ProgressView]:
    """Yield a progress view of a run.

    Args:
        run: the record; it grows.
        left: episodes that are not final yet.
    """
    tally = ProgressTally(run, left)
    if not sys.stderr.isatty():
        yield _Lines(tally)
        return
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(stderr=True, highlight=False), refresh_per_second=4, redirect_stdout=False) as live:
        terminal = _Terminal(tally, live)
        terminal.show()
        yield terminal


class ProgressTally:
    """The content of both views of a run.

    Args:
        run: the record; it grows.
        left: episodes that are not final yet.

    Attributes:
        left: updated number of these.
        failure: the last failure, as a sentence; None so far.
    """

    def __init__(self, run: Run, left: int) -> None:
        self._run = run
        self._began: float | None = None
        self._played = 0
        self._won: Counter[tuple[str, str]] = Counter()
        self._judged: Counter[tuple[str, str]] = Counter()
        self._final: Counter[tuple[str, str]] = Counter()
        self.left = left
        self.failure: str | None = None
        for line in run.finals.values():
            self._count(line)

    def add(self, line: EpisodeRecord, left: int) -> None:
        """Take note of a line."""
        self.left = left
        if self._began is None:  # models are loaded by now
            self._began = time.monotonic() - line.wall_seconds
        if line.final:
            self._played += 1
            self._count(line)
        if line.error:
            self.failure = f"{_episode_name(line)}: {line.failure}: {line.error}"

    def cells(self) -> list[tuple[str, str, str, str]]:
        """Return task, setting, episodes and success of every cell."""
        rows = []
        for cell in self._run.plan.cells:
            key = cell.cell_key
            rows.append((*key, f"{self._final[key]}/{len(cell.seeds)}", _rate(self._won[key], self._judged[key])))
        return rows

    def text(self) -> str:
        """Return how far the run is: episodes, success, pace, time left."""
        final = sum(self._final.values())
        parts = [f"{final} of {final + self.left} episodes", _rate(self._won.total(), self._judged.total())]
        if self._played and self._began is not None:
            pace = self._played / max(time.monotonic() - self._began, 1e-3)
            parts += [f"{pace * _HOUR_S:.0f} episodes/h", f"{_clock(self.left / pace)} left"]
        return ", ".join(parts)

    def _count(self, line: EpisodeRecord) -> None:
        key = line.cell_key
        self._final[key] += 1
        if line.success is not None:
            self._judged[key] += 1
            self._won[key] += bool(line.success)


class _Lines:
    """A line for each attempt."""

    def __init__(self, tally: ProgressTally) -> None:
        self._tally = tally

    def add(self, line: EpisodeRecord, left: int) -> None:
        """Write what happened, and how far the run is."""
        self._tally.add(line, left)
        again = "" if line.final else ", will be retried"
        error = f" ({line.error})" if line.error else ""
        console.note(one_line(f"{_episode_name(line)}: {line.end_reason}{error}{again}; {self._tally.text()}"))


class _Terminal:
    """A table that changes."""

    def __init__(self, tally: ProgressTally, live: Live) -> None:
        self._tally = tally
        self._live = live

    def add(self, line: EpisodeRecord, left: int) -> None:
        """Update the table."""
        self._tally.add(line, left)
        self.show()

    def show(self) -> None:
        """Draw the table."""
        self._live.update(self._render())

    def _render(self) -> RenderableType:
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        table = Table("task", "setting", "episodes", "success", box=None, pad_edge=False)
        rows = self._tally.cells()
        begun = [row for row in rows if not row[2].startswith("0/")]
        for row in [*begun[-_CELLS:], *(row for row in rows if row not in begun)][:_CELLS]:
            table.add_row(*map(Text, row))
        parts: list[RenderableType] = [table]
        if len(rows) > _CELLS:
            parts.append(Text(f"and {len(rows) - _CELLS} more", style="dim"))
        parts.append(Text(self._tally.text(), style="bold"))
        if self._tally.failure is not None:
            parts.append(
                Text(f"last failure: {self._tally.failure}", style="yellow", overflow="ellipsis", no_wrap=True)
            )
        return Group(*parts)


def _episode_name(line: EpisodeRecord) -> str:
    return f"{line.task}, {line.setting}, seed {line.seed}"


def _rate(won: int, judged: int) -> str:
    if not judged:
        return wording.NOTHING
    return f"{won} of {judged} succeeded ({wording.interval(*wilson(won / judged, judged))})"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
