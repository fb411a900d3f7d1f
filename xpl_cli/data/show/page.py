"""An episode as a self-contained HTML page with frames and curves."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from markupsafe import Markup, escape

from xpl_cli.basics import pages
from xpl_cli.data.formats import image_files

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl_cli.data.show.episode_view import Chart, EpisodeView, Strip

_WIDE, _HIGH, _EDGE = 600.0, 120.0, 4.0
_COLOURS: Final = 8
_THUMBNAIL: Final = 240


def render(view: EpisodeView) -> str:
    """Return the page of an episode."""
    facts = {
        "format": view.format,
        "robot": view.robot or "unknown",
        "steps": str(view.steps),
        "rate": f"{view.rate_hz:g} Hz" if view.rate_hz else "unknown",
        "time": f"{view.steps / view.rate_hz:.1f} s" if view.rate_hz else "unknown",
    }
    return pages.render(
        "data/episode.html.jinja",
        style="data/episode.css",
        path=view.path,
        key=view.key,
        facts=facts,
        instructions=view.instructions,
        strips=[_strip(strip) for strip in view.strips],
        charts=[_chart(chart, view.steps) for chart in view.charts],
    )


def _strip(strip: Strip) -> dict[str, Any]:
    frames = [{"step": step, "source": _source(image)} for step, image in zip(strip.steps, strip.images, strict=True)]
    return {"name": strip.name, "what": strip.what, "frames": frames}


def _source(image: NDArray[np.uint8]) -> str:
    data = image_files.encode_image(image_files.thumbnail(image, _THUMBNAIL), "jpeg")
    return f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"


def _chart(chart: Chart, steps: int) -> dict[str, Any]:
    return {
        "name": chart.name,
        "what": chart.what,
        "low": f"{chart.low:.4g}",
        "high": f"{chart.high:.4g}",
        "lost": chart.lost,
        "last": max(steps - 1, 0),
        "svg": _svg(chart) if chart.curves.size else None,
        "beside": chart.beside is not None,
        "names": [{"name": name, "kind": f"c{index % _COLOURS}"} for index, name in enumerate(chart.names)]
        if chart.curves.size and len(chart.names) > 1
        else [],
    }


def _svg(chart: Chart) -> Markup:
    """Return the curves of a column, one colour per entry; the column drawn for comparison is dashed."""
    lines = []
    for rows, kind in ((chart.beside, "beside"), (chart.curves, "curve")):
        for index in range(0 if rows is None else rows.shape[1]):
            points = _points(chart, rows[:, index]) if rows is not None else []
            title = escape(chart.names[index]) if index < len(chart.names) else Markup()
            lines += [
                Markup('<polyline class="{} c{}" points="{}"><title>{}</title></polyline>').format(
                    kind, index % _COLOURS, piece, title
                )
                for piece in points
            ]
    return Markup('<svg viewBox="0 0 {} {}" preserveAspectRatio="none" role="img" aria-label="{}">{}</svg>').format(
        int(_WIDE), int(_HIGH), chart.name, Markup().join(lines)
    )


def _points(chart: Chart, values: NDArray[np.float64]) -> list[str]:
    """Return the points of a curve, split at numbers that are not finite."""
    span = max(chart.high - chart.low, 1e-12)
    last = max(int(chart.steps[-1]), 1)
    across = chart.steps / last * _WIDE
    down = _EDGE + (1 - (values - chart.low) / span) * (_HIGH - 2 * _EDGE)
    pieces: list[list[str]] = [[]]
    for x, y in zip(across, down, strict=True):
        if np.isfinite(y):
            pieces[-1].append(f"{x:.1f},{min(max(y, 0.0), _HIGH):.1f}")
        elif pieces[-1]:
            pieces.append([])
    return [" ".join(piece) for piece in pieces if piece]
