"""The verdict on two compared runs, and its caveats, in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl_cli.basics.phrases import count_noun
from xpl_cli.basics.untrusted import as_lines
from xpl_cli.evaluation.statistics import caveats
from xpl_cli.evaluation.statistics.wording import NOTHING, aligned, percent, points, were

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.evaluation.statistics.comparison_model import Comparison, ComparisonRow

_ALPHA: Final = 0.05
_LEAST: Final = 0.001
_HEADER: Final = (
    "task",
    "setting",
    "pairs",
    "first",
    "second",
    "only first",
    "only second",
    "difference",
    "p",
    "p (Holm)",
)


def verdict(result: Comparison) -> str:
    """Return the answer in a sentence."""
    first, second = result.names
    row = result.overall
    rates, (low, high) = [percent(row.first_rate), percent(row.second_rate)], row.interval
    if not row.only_first + row.only_second:
        sentence = f"{first} and {second} succeeded in the same episodes: {row.both} of {row.pairs}."
        return f"{sentence} A difference of {points(low, high)} points is still compatible with these data."
    evidence = f"{count_noun(row.pairs, 'pair')}, {_p(row.p_value)}"
    if row.p_value >= _ALPHA:
        return (
            f"Neither is shown to be better: {first} has {rates[0]}, {second} has {rates[1]} ({evidence}). "
            f"Anything from {points(low, high)} points for {second} fits these data."
        )
    if row.only_second > row.only_first:
        gain = points(low, high)
        return f"{second} is better than {first}: {rates[1]} against {rates[0]}, by {gain} points ({evidence})."
    return (
        f"{first} is better than {second}: {rates[0]} against {rates[1]}, by {points(-high, -low)} points ({evidence})."
    )


def notes(result: Comparison, *, stops: bool) -> list[str]:
    """Return what a reader should know before believing the verdict.

    Args:
        result: the comparison.
        stops: whether tasks ended when their interval was narrow enough.
    """
    return [
        *_difference_notes(result),
        *_test_notes(result.overall),
        *_task_notes(result),
        *_pair_notes(result),
        *([caveats.of_stopping()] if stops else []),
        caveats.scope(),
    ]


def format_p_value(value: float) -> str:
    """Return a p-value as people read it."""
    return f"< {_LEAST}" if value < _LEAST else f"{value:.3f}"


def text(result: Comparison) -> str:
    """Return a comparison as text: the verdict, the table, and its caveats."""
    first, second = result.names
    rows = [*result.cells, *([result.overall] if len(result.cells) > 1 else [])]
    return as_lines(
        [
            result.verdict,
            "",
            f"first: {first}, second: {second}; difference: second minus first, in points",
            *aligned(_HEADER, [_texts(row) for row in rows]),
            "",
            *(f"- {note}" for note in result.notes),
        ]
    )


def _difference_notes(result: Comparison) -> Iterator[str]:
    for entry in result.differences:
        yield f"The runs differ in {entry.what}, too: {entry.first} against {entry.second}."
    first, second = result.first, result.second
    if first.run == second.run:
        yield "Both runs have the same plan: what differs between them is chance, or the machine."
    elif first.checkpoint is not None and first.checkpoint == second.checkpoint:
        yield "Both runs loaded the same checkpoint."


def _test_notes(row: ComparisonRow) -> Iterator[str]:
    discordant = row.only_first + row.only_second
    least = 2 * 0.5**discordant
    if discordant and least >= _ALPHA:
        yield (
            f"Only {discordant} of {count_noun(row.pairs, 'pair')} ended differently. Had all of them favoured "
            f"one side, it would still be {_p(least)}: so few pairs cannot show a difference."
        )
    low, high = row.interval
    if row.p_value >= _ALPHA and not low <= 0 <= high:
        yield "The interval leaves out 0 although the test is not sure: the test is exact, the interval is approximate."


def _task_notes(result: Comparison) -> Iterator[str]:
    rows = result.cells
    if len(rows) < 2:
        return
    different = [f"{row.task} ({row.setting})" for row in rows if (row.adjusted_p_value or 0.0) < _ALPHA]
    result_text = (
        f"a difference is shown in {', '.join(different)}" if different else "none of them shows a difference by itself"
    )
    yield f"Corrected for looking at {len(rows)} tasks and settings (Holm), {result_text}."
    if len({row.pairs for row in rows}) > 1:
        yield "Not all rows have equally many pairs: the test counts all pairs alike, the difference all rows."


def _pair_notes(result: Comparison) -> Iterator[str]:
    pairs = result.overall.pairs
    for name, count in zip(result.names, (result.left_out.first, result.left_out.second), strict=True):
        if count:
            subject = were(count, "episode", f"of {name}")
            yield f"{subject} left out: the other run has none that counts for the same seed."
    same = result.same_trajectories
    if same == pairs:
        yield "In all pairs the two moved exactly alike: these are the same policy, as far as can be seen."
    elif same:
        yield f"In {same} of {count_noun(pairs, 'pair')} the two moved exactly alike."
    if not result.known_layouts:
        yield "The records hold no layouts: that equal seeds gave equal scenes is an assumption."


def _p(value: float) -> str:
    return f"p {format_p_value(value)}" if value < _LEAST else f"p = {format_p_value(value)}"


def _texts(row: ComparisonRow) -> tuple[str, ...]:
    adjusted = row.adjusted_p_value
    return (
        row.task or "all",
        row.setting or "all",
        str(row.pairs),
        percent(row.first_rate),
        percent(row.second_rate),
        str(row.only_first),
        str(row.only_second),
        f"{round(row.difference * 100):+d} ({points(*row.interval)})",
        format_p_value(row.p_value),
        NOTHING if adjusted is None else format_p_value(adjusted),
    )
