"""Figures of lines, dots and words, that become SVG on a page and pixels in a picture."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from markupsafe import Markup, escape

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from PIL.ImageDraw import ImageDraw

Point = tuple[float, float]

COLOURS: Final = {
    "ground": (214, 218, 224),
    "link": (70, 78, 90),
    "wanted": (196, 104, 28),
    "arrow": (123, 92, 173),
    "x": (206, 44, 44),
    "y": (36, 146, 60),
    "z": (42, 92, 214),
    "word": (60, 66, 74),
}
"""By kind of a shape; the page's styles have the same for paper that is dark."""


@dataclass(frozen=True)
class LineShape:
    """A line through points; with a tip at its end if `tip`."""

    kind: str
    points: tuple[Point, ...]
    width: float = 1.5
    tip: bool = False
    dashed: bool = False


@dataclass(frozen=True)
class DotShape:
    """A filled circle."""

    kind: str
    at: Point
    radius: float = 3.0


@dataclass(frozen=True)
class TextShape:
    """Words whose left end, middle or right end (start, middle, end) is at a point."""

    kind: str
    at: Point
    text: str
    size: float = 11.0
    anchor: str = "start"


Shape = LineShape | DotShape | TextShape


@dataclass(frozen=True)
class VectorFigure:
    """Shapes on paper of a size; the origin is at the upper left."""

    width: float
    height: float
    shapes: tuple[Shape, ...]
    label: str

    def svg(self) -> Markup:
        """Return it for a page; styles by class."""
        inside = "".join(_SVG[type(shape)](shape) for shape in self.shapes)
        head = (
            f'<svg class="figure" viewBox="0 0 {self.width:g} {self.height:g}" role="img" '
            f'aria-label="{escape(self.label)}">'
        )
        return Markup(f"{head}{inside}</svg>")  # noqa: S704 - numbers, our own classes and escaped words

    def draw(self, pen: ImageDraw, left: float, top: float, scale: float = 1.0) -> None:
        """Draw it on a picture."""
        from PIL import ImageFont

        def at(point: Point) -> Point:
            return left + scale * point[0], top + scale * point[1]

        for shape in self.shapes:
            colour = COLOURS[shape.kind]
            if isinstance(shape, DotShape):
                pen.circle(at(shape.at), scale * shape.radius, fill=colour)
            elif isinstance(shape, TextShape):
                anchor = {"start": "ls", "middle": "ms", "end": "rs"}[shape.anchor]
                font = ImageFont.load_default(scale * shape.size)
                pen.text(at(shape.at), shape.text, colour, font=font, anchor=anchor)
            else:
                points = [at(point) for point in shape.points]
                for one, two in _pieces(points, 5 * scale if shape.dashed else 0.0):
                    pen.line((*one, *two), fill=colour, width=max(1, round(scale * shape.width)))
                if shape.tip:
                    pen.polygon(_tip(points[-2], points[-1], scale * (4 + shape.width)), fill=colour)


def _line(shape: LineShape) -> str:
    path = "L".join(f"{x:.1f} {y:.1f}" for x, y in shape.points)
    dash = ' stroke-dasharray="5 5"' if shape.dashed else ""
    made = f'<path class="{shape.kind}" d="M{path}" stroke-width="{shape.width:g}"{dash}/>'
    if shape.tip:
        corners = "L".join(f"{x:.1f} {y:.1f}" for x, y in _tip(shape.points[-2], shape.points[-1], 4 + shape.width))
        made += f'<path class="{shape.kind} full" d="M{corners}z"/>'
    return made


def _dot(shape: DotShape) -> str:
    x, y = shape.at
    return f'<circle class="{shape.kind} full" cx="{x:.1f}" cy="{y:.1f}" r="{shape.radius:g}"/>'


def _word(shape: TextShape) -> str:
    x, y = shape.at
    attributes = f'x="{x:.1f}" y="{y:.1f}" font-size="{shape.size:g}" text-anchor="{shape.anchor}"'
    return f'<text class="{shape.kind}" {attributes}>{escape(shape.text)}</text>'


_SVG: Final[dict[type, Callable[[Any], str]]] = {LineShape: _line, DotShape: _dot, TextShape: _word}


def _tip(start: Point, end: Point, size: float) -> list[Point]:
    """Return the corners of an arrow's tip."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = max((dx * dx + dy * dy) ** 0.5, 1e-6)
    dx, dy = dx / length * size, dy / length * size
    back = end[0] - dx, end[1] - dy
    return [end, (back[0] - dy / 2, back[1] + dx / 2), (back[0] + dy / 2, back[1] - dx / 2)]


def _pieces(points: Sequence[Point], dash: float) -> Iterable[tuple[Point, Point]]:
    for one, two in itertools.pairwise(points):
        length = ((two[0] - one[0]) ** 2 + (two[1] - one[1]) ** 2) ** 0.5
        count = int(length / dash) if dash else 1
        for dash_number in range(0, max(1, count), 2):
            ends = (dash_number / max(1, count), min(1.0, (dash_number + 1) / max(1, count)))
            yield tuple(  # type: ignore[misc]
                (one[0] + share * (two[0] - one[0]), one[1] + share * (two[1] - one[1])) for share in ends
            )
