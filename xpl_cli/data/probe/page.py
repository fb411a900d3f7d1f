"""The probe's answers and plots as a self-contained HTML page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from markupsafe import Markup, escape

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np

    from xpl_cli.data.probe.commands import CommandPlot
    from xpl_cli.data.probe.probe import ProbeResult

_WIDTH, _HEIGHT, _EDGE = 720, 150, 8
_MOST = 400
_STYLE = Markup("""
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; color: #1c2733; }
table { border-collapse: collapse; width: 100%; } td, th { text-align: left; padding: .3em .6em; vertical-align: top; }
tr { border-top: 1px solid #d7dde3; } .open { color: #8a5a00; } code { font-size: 13px; }
svg { width: 100%; height: auto; background: #f6f8fa; } .state { stroke: #1f6feb; } .command { stroke: #d1580b; }
path { fill: none; stroke-width: 1.5; } figure { margin: 1em 0; } b.state { color: #1f6feb; }
b.command { color: #d1580b; }
""")


def page(result: ProbeResult, title: str) -> str:
    """Return the page as HTML."""
    body = Markup("").join(_rows(result))
    plots = Markup("").join(map(_figure, result.plots))
    template = Markup(
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        "<style>{style}</style></head><body><h1>{title}</h1><p>{count} episodes, {rows} steps were read.</p>"
        "<table><tr><th>convention</th><th>of</th><th>value</th><th>evidence</th><th>margin</th></tr>{body}</table>"
        "<h2>Commands and states</h2>"
        '<p><b class="state">Blue</b> is the state, <b class="command">orange</b> the command, each over its own range.'
        "</p>{plots}</body></html>\n"
    )
    return str(
        template.format(title=title, style=_STYLE, count=result.episodes, rows=result.rows, body=body, plots=plots)
    )


def _rows(result: ProbeResult) -> Iterator[Markup]:
    """Yield a row for each answer."""
    for one in result.answers:
        value = Markup("<b>{}</b>").format(one.value) if one.is_known else Markup('<b class="open">unknown</b>')
        needs = f" Needed: {one.needs}." if one.needs else ""
        margin = "" if one.margin is None else f"{min(one.margin, 1000):.3g}"
        second = f" over {one.second}" if one.second is not None and margin else ""
        cells = Markup("<td>{}</td><td><code>{}</code></td><td>{}</td><td>{}</td><td>{}</td>")
        row = cells.format(one.topic, one.subject, value, f"{one.evidence}.{needs}", f"{margin}{second}")
        yield Markup("<tr>{}</tr>").format(row)


def _figure(plot: CommandPlot) -> Markup:
    """Return a plot of state and command, each scaled to its own range."""
    paths = Markup("").join(
        Markup('<path class="{}" d="{}"/>').format(name, _path(values))
        for name, values in (("state", plot.state), ("command", plot.command))
    )
    template = Markup('<figure><figcaption>{}</figcaption><svg viewBox="0 0 {} {}" role="img">{}</svg></figure>')
    return template.format(escape(plot.title), _WIDTH, _HEIGHT, paths)


def _path(values: np.ndarray) -> str:
    """Return an SVG path scaled to the range of the values."""
    sampled: Sequence[float] = values[:: max(1, -(-len(values) // _MOST))].tolist()
    low, high = min(sampled), max(sampled)
    span = (high - low) or 1.0
    right = (_WIDTH - 2 * _EDGE) / max(len(sampled) - 1, 1)
    up = _HEIGHT - 2 * _EDGE
    points = (
        f"{_EDGE + at * right:.1f} {_EDGE + up * (1 - (value - low) / span):.1f}" for at, value in enumerate(sampled)
    )
    return f"M{' L'.join(points)}"
