"""Rates, intervals and tables as people read them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

from xpl_cli.basics.phrases import count_noun
from xpl_cli.basics.untrusted import as_lines

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.evaluation.statistics.intervals import Interval
    from xpl_cli.evaluation.statistics.summary_model import Summary, SummaryRow


class Rated(Protocol):
    """What has a success rate: a row of a summary, or of a ranking."""

    @property
    def success_rate(self) -> float | None:
        """Share of successes."""

    @property
    def success_interval(self) -> Interval | None:
        """Where it lies with 95 % confidence."""


NOTHING: Final = "-"
HEADER: Final = ("task", "setting", "episodes", "success", "95 % interval", "score", "95 % interval")


def percent(share: float) -> str:
    """Return a share in percent: `84 %`."""
    return f"{share:.0%}".replace("%", " %")


def interval(low: float, high: float) -> str:
    """Return an interval of shares in percent, with a digit more where it is narrow: `71 to 92 %`."""
    digits = 0 if high - low >= 0.1 else 1
    return f"{low * 100:.{digits}f} to {high * 100:.{digits}f} %"


def points(low: float, high: float) -> str:
    """Return an interval of differences in percentage points, with signs: `-3 to +12`."""
    return f"{round(low * 100):+d} to {round(high * 100):+d}"


def were(count: int, thing: str, which: str = "") -> str:
    """Return a number with noun and verb: `1 episode was`, `3 episodes of Foo were`."""
    return f"{count_noun(count, thing)}{which and ' ' + which} {'was' if count == 1 else 'were'}"


def rate(row: Rated) -> str:
    """Return a row's success rate with its interval: `84 % (71 to 92 %)`."""
    if row.success_rate is None or row.success_interval is None:
        return NOTHING
    return f"{percent(row.success_rate)} ({interval(*row.success_interval)})"


def table(summary: Summary) -> list[tuple[str, ...]]:
    """Return the texts below HEADER."""
    return [_texts(row) for row in table_rows(summary)]


def table_rows(summary: Summary) -> list[SummaryRow]:
    """Return the rows that a table has: cells, settings where there are several, and all together where it is more."""
    settings = summary.settings if len(summary.settings) > 1 else []
    return [*summary.cells, *settings, *([summary.overall] if len(summary.cells) > 1 else [])]


def text(summary: Summary) -> str:
    """Return a summary as text: the table, failures, and caveats."""
    lines = [
        f"{summary.policy} in {summary.environment}, {summary.embodiment}, {summary.action_type} control",
        "",
        *aligned(HEADER, table(summary)),
    ]
    failures = summary.overall.failures
    if any(failures.values()):
        counts = ", ".join(f"{kind} {count}" for kind, count in failures.items() if count)
        lines += ["", f"Failures: {counts}"]
    return as_lines([*lines, "", *(f"- {note}" for note in (*summary.notes, *summary.execution.notes))])


def aligned(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table with aligned columns."""
    lines = [header, *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]


def _texts(row: SummaryRow) -> tuple[str, ...]:
    success = score = (NOTHING, NOTHING)
    if row.success_rate is not None and row.success_interval is not None:
        success = (percent(row.success_rate), interval(*row.success_interval))
    if row.mean_score is not None and row.score_interval is not None:
        low, high = row.score_interval
        score = (f"{row.mean_score:.2f}", f"{low:.2f} to {high:.2f}")
    return (row.task or "all", row.setting or "all", f"{row.successes}/{row.judged}", *success, *score)
