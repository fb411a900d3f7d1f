"""Plot of predicted and demonstrated actions over one episode, as SVG."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.offline.demonstrations.action_errors import Chunks, ErrorMetric

_WIDTH, _HEIGHT, _EDGE = 480, 180, 28
_MOST_POINTS: Final = 64
_COLOURS = ("#333333", "#d62728", "#1f77b4")


def plot_errors(metric: ErrorMetric, declared: Chunks, changed: Chunks, words: str) -> tuple[str, str]:
    """Return an SVG plot, and the number of the action that it shows: the one that the change improves most.

    Args:
        metric: of the demonstrations.
        declared: answers of the adapter.
        changed: answers with the change.
        words: of the change, for the legend.
    """
    episode = metric.session.question_steps[0][0]
    questions = [number for number, (one, _) in enumerate(metric.session.question_steps) if one == episode]
    key, index = _most_improved(metric, declared, changed, questions)
    rows = metric.session.recordings[episode].commanded[key][:, index]
    stride = max(1, len(rows) // _MOST_POINTS)
    lines = [[(float(at), float(rows[at])) for at in range(0, len(rows), stride)]]
    chunks = [[_trace(metric, given, number, key, index) for number in questions] for given in (declared, changed)]
    values = [value for _, value in lines[0]] + [
        value for traces in chunks for trace in traces for _, value in trace if np.isfinite(value)
    ]
    low, high = min(values), max(values)
    span = (high - low) or 1.0

    def points(trace: Sequence[tuple[float, float]]) -> str:
        return " ".join(
            f"{_EDGE + at / max(1, len(rows) - 1) * (_WIDTH - 2 * _EDGE):.1f},"
            f"{_HEIGHT - _EDGE - (value - low) / span * (_HEIGHT - 2 * _EDGE):.1f}"
            for at, value in trace
            if np.isfinite(value)
        )

    strokes = [_line(points(lines[0]), _COLOURS[0])]
    for colour, traces in zip(_COLOURS[1:], chunks, strict=True):
        strokes += [_line(points(trace), colour) for trace in traces if trace]
    labels = ("demonstrated", "as declared", f"with {words}")
    legend = "".join(
        f'<text x="{_EDGE + 150 * slot}" y="14" fill="{colour}">{escape(text[:40])}</text>'
        for slot, (text, colour) in enumerate(zip(labels, _COLOURS, strict=True))
    )
    part = f"{key}[{index}]"
    axes = (
        f'<text x="{_EDGE}" y="{_HEIGHT - 8}">{escape(part)}, steps 0 to {len(rows) - 1}</text>'
        f'<text x="2" y="{_EDGE}">{high:.2g}</text><text x="2" y="{_HEIGHT - _EDGE}">{low:.2g}</text>'
    )
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" '
        f'height="{_HEIGHT}" font-family="sans-serif" font-size="10"><rect width="100%" height="100%" fill="#fff"/>'
    )
    return f"{head}{legend}{axes}{''.join(strokes)}</svg>\n", part


def _line(points: str, colour: str) -> str:
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>'


def _trace(metric: ErrorMetric, answers: Chunks, number: int, key: str, index: int) -> list[tuple[float, float]]:
    step = metric.session.question_steps[number][1]
    chunk = answers.get(number) or ()
    return [
        (float(step + offset), float(one[key][index]))
        for offset, one in enumerate(chunk[: metric.horizon])
        if one is not None and step + offset < metric.session.recordings[metric.session.question_steps[number][0]].steps
    ]


def _most_improved(metric: ErrorMetric, declared: Chunks, changed: Chunks, questions: Sequence[int]) -> tuple[str, int]:
    """Return key and index of the number whose error falls most, relative to its range."""
    best, most_improved = -np.inf, next(iter((key, 0) for key in metric.session.recordings[0].commanded))
    for key, rows in metric.session.recordings[metric.session.question_steps[questions[0]][0]].commanded.items():
        for index in range(rows.shape[1]):
            errors = [
                np.nanmean([abs(value - rows[int(at), index]) for at, value in trace] or [np.nan])
                for answers in (declared, changed)
                if (trace := [point for number in questions for point in _trace(metric, answers, number, key, index)])
            ]
            if len(errors) == 2 and (gain := (errors[0] - errors[1]) / (np.ptp(rows[:, index]) or 1.0)) > best:
                best, most_improved = gain, (key, index)
    return most_improved
