"""The metrics of many adapters as one SVG picture; it follows the reader's light or dark background."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.metrics.measure import Distribution, Metrics, distributions, printable
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from pathlib import Path

ROW: Final = 18
TOP: Final = 64
BOTTOM: Final = 40
NAMES: Final = 190
PANEL: Final = 300
GAP: Final = 40
_LONGEST_NAME: Final = 28

_STYLE: Final = """
text { font: 12px system-ui, sans-serif; fill: #24292f }
.title { font-weight: 600 } .small { font-size: 10px }
.lines { fill: #2f6fb0 } .distance { fill: #b35c1e } .track { fill: #8884 }
.mark { stroke: #57606a; stroke-dasharray: 3 3 }
@media (prefers-color-scheme: dark) {
  text { fill: #d0d7de } .lines { fill: #6ca6e8 } .distance { fill: #e39a5b } .mark { stroke: #9aa4ae }
}"""


def check(path: Path) -> None:
    """Refuse, before anything is measured, a file that is not to be an SVG.

    Raises:
        UserError: with the name that would do.
    """
    if path.suffix.lower() != ".svg":
        raise UserError(f"--plot writes SVG, got {path.name!r}", hint=f"--plot {path.with_suffix('.svg')}")


def write(measured: Sequence[Metrics], path: Path) -> None:
    """Write the picture.

    Raises:
        UserError: if the file cannot be written.
    """
    try:
        atomic.write_file(path, svg(measured).encode())
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}") from None


def svg(measured: Sequence[Metrics]) -> str:
    """Return a picture with a bar for each adapter and measure, the largest model.py first, and median and p90."""
    ordered = sorted(measured, key=lambda one: (-(one.lines or 0), one.name))
    lines, distances = distributions(measured)
    width = NAMES + 2 * PANEL + 2 * GAP + 20
    height = TOP + ROW * len(ordered) + BOTTOM
    second = NAMES + PANEL + GAP
    most = max((one.lines or 0 for one in ordered), default=0) or 1
    size = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    lines_panel = _Panel(NAMES, "model.py, lines of code", "lines", most, "{:.0f}".format)
    loop_panel = _Panel(second, "distance of the loop", "distance", 1.0, "{:.2f}".format)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">',
        f"<title>Lines of model.py and distance of the evaluation loop, {len(ordered)} adapters</title>",
        f"<style>{_STYLE}</style>",
        *(_text(NAMES - 8, TOP + ROW * row + 13, _name(one), end=True) for row, one in enumerate(ordered)),
        *lines_panel.draw([one.lines for one in ordered], lines),
        *loop_panel.draw([one.distance for one in ordered], distances),
        _text(NAMES, height - 14, "no blank lines, comments, docstrings", "small"),
        _text(second, height - 14, "0 is the reference, 1 shares nothing with it", "small"),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


@dataclass(frozen=True)
class _Panel:
    """One measure: where it stands, how it is called, shown and scaled."""

    left: int
    title: str
    kind: str
    longest: float
    shown: Callable[[float], str]

    def draw(self, values: Sequence[float | None], distribution: Distribution | None) -> Iterator[str]:
        """Yield the title, one bar for each value, and the marks of the distribution."""
        yield _text(self.left, 20, self.title, "title")
        for row, value in enumerate(values):
            top = TOP + ROW * row
            yield self._bar("track", top, PANEL)
            if value is None:
                yield _text(self.left + 4, top + 13, "not measured", "small")
            else:
                yield self._bar(self.kind, top, self._length(value))
                yield _text(self.left + PANEL + 4, top + 13, self.shown(value), "small")
        bottom = TOP + ROW * len(values) + 4
        for place, key in enumerate(("median", "p90")):
            value = getattr(distribution, key, None)
            if value is not None:
                x = self.left + self._length(value)
                yield f'<line class="mark" x1="{x}" x2="{x}" y1="{TOP - 4}" y2="{bottom}"/>'
                # On two lines, because median and p90 may be close together.
                label = f"{key} {self.shown(value)}"
                yield _text(min(x, self.left + PANEL - 50), TOP - 8 - 12 * place, label, "small")

    def _bar(self, kind: str, top: int, length: float) -> str:
        return f'<rect class="{kind}" x="{self.left}" y="{top + 3}" width="{length}" height="{ROW - 6}" rx="2"/>'

    def _length(self, value: float) -> float:
        return round(PANEL * value / self.longest, 1)


def _text(x: float, y: float, text: str, kind: str = "", *, end: bool = False) -> str:
    anchor = ' text-anchor="end"' if end else ""
    label = f' class="{kind}"' if kind else ""
    return f'<text x="{x}" y="{y}"{label}{anchor}>{escape(text)}</text>'


def _name(one: Metrics) -> str:
    name = printable(one.name)
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"
