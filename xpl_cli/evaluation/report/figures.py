"""Small charts for the page, as SVG without text.

Every chart fills its box, so it is drawn in shares of width and height; dots and lines are strokes that do not scale.
Labels are HTML beside it, and stay readable on a phone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from markupsafe import Markup, escape

from xpl_cli.basics.untrusted import escape_controls

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence


def strip(rate: float | None, interval: Sequence[float] | None, kind: str, label: str) -> Markup:
    """Return a rate as a dot on its interval, on an axis from 0 to 1."""
    parts = [_rect("track", 0, 42, 100, 16)]
    if interval is not None:
        parts.append(_rect(f"band {kind}", 100 * interval[0], 42, 100 * (interval[1] - interval[0]), 16))
    if rate is not None:
        parts.append(_dot(kind, 100 * rate, 50))
    return _svg("strip", label, parts)


def bar(rate: float | None, interval: Sequence[float] | None, kind: str, label: str) -> Markup:
    """Return a rate as a bar with the whisker of its interval, on an axis from 0 to 1."""
    parts = [_rect("track", 0, 10, 100, 80)]
    if rate is not None:
        parts.append(_rect(kind, 0, 10, 100 * rate, 80))
    if interval is not None:
        low, high = (100 * end for end in interval)
        parts += [_line("halo", low, 50, high, 50), _line("whisker", low, 50, high, 50)]
    return _svg("bar", label, parts)


def difference(value: float | None, interval: Sequence[float] | None, kind: str, label: str) -> Markup:
    """Return a difference of two rates as a dot on its interval, on an axis from -1 to 1 with a line at 0."""
    parts = [_rect("track", 0, 42, 100, 16), _line("zero", 50, 0, 50, 100)]
    if interval is not None:
        low, high = (50 + 50 * end for end in interval)
        parts.append(_rect(f"band {kind}", low, 42, high - low, 16))
    if value is not None:
        parts.append(_dot(kind, 50 + 50 * value, 50))
    return _svg("strip", label, parts)


def shares(counts: Mapping[str, int], label: str) -> Markup:
    """Return how a total is made up, as parts of one bar; the keys are their classes."""
    total = sum(counts.values()) or 1
    parts, left = [], 0.0
    for kind, count in counts.items():
        width = 100 * count / total
        parts.append(_rect(kind, left, 0, width, 100))
        left += width
    return _svg("shares", label, parts)


def columns(counts: Sequence[int], label: str) -> Markup:
    """Return a histogram; bins are equally wide."""
    most, width = max(counts, default=0) or 1, 100 / max(1, len(counts))
    drawn = ((index, 96 * count / most) for index, count in enumerate(counts) if count)
    parts = [_rect("column", (index + 0.06) * width, 100 - tall, 0.88 * width, tall) for index, tall in drawn]
    return _svg("columns", label, [*parts, _line("base", 0, 100, 100, 100)])


def _svg(kind: str, label: str, parts: Iterable[str]) -> Markup:
    text = escape(escape_controls(label))
    head = f'<svg class="{kind}" viewBox="0 0 100 100" preserveAspectRatio="none" role="img" aria-label="{text}">'
    return Markup(f"{head}{''.join(parts)}</svg>")  # noqa: S704 - made of numbers, our own classes and an escaped label


def _rect(kind: str, x: float, y: float, width: float, height: float) -> str:
    return f'<rect class="{kind}" x="{x:.6g}" y="{y:.6g}" width="{max(0.0, width):.6g}" height="{height:.6g}"/>'


def _line(kind: str, x1: float, y1: float, x2: float, y2: float) -> str:
    return f'<path class="{kind}" d="M{x1:.6g} {y1:.6g}L{x2:.6g} {y2:.6g}"/>'


def _dot(kind: str, x: float, y: float) -> str:
    # A line without length whose ends are round: the one circle that stays a circle in a stretched box.
    return f'<path class="dot {kind}" d="M{x:.6g} {y:.6g}h0"/>'
