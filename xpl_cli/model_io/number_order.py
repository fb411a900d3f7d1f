"""Patterns of order: numbers that appear at the index of others, twice, or thresholded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl_cli.model_io.linear_fit import AnswerRows
from xpl_cli.model_io.patterns import Pattern

if TYPE_CHECKING:
    from xpl_cli.model_io.difference import Differences, EpisodeAnswers

_LEAST = 12
"""Steps that say so at least."""
_LIKE = 1e-5
"""Share of its range that a number may be off by to be another one."""
_STILL = 1e-9

Column = np.ndarray


def order_patterns(episodes: Sequence[EpisodeAnswers], before: Differences, tolerance: float) -> Iterator[Pattern]:
    """Yield patterns of order among the numbers that differ.

    Args:
        episodes: all episodes.
        before: how far the answers are, by number.
        tolerance: largest share that is no difference.
    """
    rows = AnswerRows.of(episodes)
    differing = [part for part, share in before.items() if share > tolerance]
    if rows is None or not differing or len(next(iter(rows.golden.values()), ())) < _LEAST:
        return
    yield from _thresholded(rows, differing)
    yield from _duplicated(rows, differing)
    yield from _permuted(rows, differing)


def _thresholded(rows: AnswerRows, differing: Sequence[str]) -> Iterator[Pattern]:
    """Yield grippers that are only fully open or fully closed, where the model's are not."""
    for part in differing:
        if _is_gripper(part):
            adapter, golden = np.unique(_column(rows.adapter, part)), np.unique(_column(rows.golden, part))
            if len(adapter) <= 2 < len(golden) and len(golden) > _LEAST:
                yield Pattern(
                    f"{part} is only ever {' or '.join(f'{one:g}' for one in adapter)}: a threshold", "gripper"
                )
                return


def _duplicated(rows: AnswerRows, differing: Sequence[str]) -> Iterator[Pattern]:
    """Yield two numbers that are always equal, where the model's differ."""
    parts = _parts(rows.adapter)
    for part in differing:
        for other in parts:
            if other == part or _still(rows, part) or _is_gripper(part) != _is_gripper(other):
                continue
            alike = np.array_equal(_column(rows.adapter, part), _column(rows.adapter, other))
            if alike and not np.array_equal(_column(rows.golden, part), _column(rows.golden, other)):
                convention = "gripper" if _is_gripper(part) else "joint_order"
                yield Pattern(f"{part} and {other} are always equal, and the model's differ", convention)
                return


def _permuted(rows: AnswerRows, differing: Sequence[str]) -> Iterator[Pattern]:
    """Yield numbers that appear at the index of others, as values or as deltas from the state."""
    parts = [part for part in _parts(rows.adapter) if not _is_turn(part)]
    sources: dict[str, str] = {}
    for part in (part for part in differing if not _is_turn(part) and not _still(rows, part)):
        for other in parts:
            if other != part and _is_output_as(rows, part, other):
                sources[part] = other
                break
    if not sources or (len(sources) == 1 and len(differing) > 2):
        return
    (part, other), *more = sources.items()
    more_numbers = f" (and {len(more)} more numbers)" if more else ""
    only = all(map(_is_gripper, (*sources, *sources.values())))
    yield Pattern(f"what {part} should be is in {other}{more_numbers}", "gripper" if only else "joint_order")


def _is_output_as(rows: AnswerRows, part: str, other: str) -> bool:
    """Tell whether the golden values of one number are the adapter's values of another."""
    golden, adapter = _column(rows.golden, part), _column(rows.adapter, other)
    if _is_line(golden, adapter):
        return True
    return _is_line(golden - _column(rows.states, part), adapter - _column(rows.states, other))


def _is_line(golden: Column, adapter: Column) -> bool:
    inside = np.ones(len(adapter), bool)
    for values in (golden, adapter):  # at the ends an opening may have been clipped
        if values.min() >= spec.GRIPPER_CLOSED and values.max() <= spec.GRIPPER_OPEN:
            inside &= (values > spec.GRIPPER_CLOSED) & (values < spec.GRIPPER_OPEN)
    if inside.sum() < max(_LEAST, len(adapter) // 4) or np.ptp(adapter[inside]) <= _STILL:
        return False
    slope, constant = np.polyfit(adapter[inside], golden[inside], 1)
    residual = np.abs(slope * adapter[inside] + constant - golden[inside]).max()
    return bool(residual <= _LIKE * np.ptp(golden[inside]))


def _parts(rows: Mapping[str, Column]) -> list[str]:
    return [f"{key}[{index}]" for key, values in rows.items() for index in range(values.shape[1])]


def _column(rows: Mapping[str, Column], part: str) -> Column:
    key, _, rest = part.partition("[")
    return rows[key][:, int(rest[:-1])]


def _still(rows: AnswerRows, part: str) -> bool:
    return bool(np.ptp(_column(rows.golden, part)) <= _STILL)


def _is_gripper(part: str) -> bool:
    return part.partition("[")[0].endswith(spec.State.EE_JOINT_STATE)


def _is_turn(part: str) -> bool:
    key, _, rest = part.partition("[")
    return key.endswith(spec.State.EE_POSE) and int(rest[:-1]) >= spec.POSITION_DIM
