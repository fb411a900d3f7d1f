"""The whole report as one PNG, for chats and reviews."""

from __future__ import annotations

import io
import textwrap
from typing import TYPE_CHECKING, Final

from xpl_cli.model_io.show import formatting

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from PIL import Image

    from xpl_cli.model_io.show.numbers import Number
    from xpl_cli.model_io.show.report import ShowReport
    from xpl_cli.model_io.show.views import ImageView

_WIDTH, _EDGE, _GAP = 1500, 36, 18
_TALLEST: Final = 24_000
"""Pixels; what does not fit is on the page."""
_PAPER, _INK, _SOFT, _ALARM, _RULE = (252, 252, 251), (27, 31, 36), (93, 100, 109), (184, 40, 28), (222, 225, 229)
_PICTURE: Final = (300, 225)
"""Width and height in which a picture is drawn."""
_STEP: Final = 800
"""Pixels that whatever is drawn next needs at most, but for long words."""
_COLUMNS: Final = (36, 330, 150, 60, 190, 200, 400)
_LINE: Final = 20
_MOST_LINES: Final = 20


class _Paper:
    """A picture that grows downwards."""

    def __init__(self) -> None:
        from PIL import Image, ImageDraw

        self.image = Image.new("RGB", (_WIDTH, 4 * _STEP), _PAPER)
        self.pen = ImageDraw.Draw(self.image)
        self.top = _EDGE

    def make_space(self) -> bool:
        """Enlarge the picture for the next item; tell whether it still fits."""
        if self.top > self.image.height - _STEP:
            from PIL import Image, ImageDraw

            made = Image.new("RGB", (_WIDTH, 2 * self.image.height), _PAPER)
            made.paste(self.image)
            self.image, self.pen = made, ImageDraw.Draw(made)
        return self.top < _TALLEST

    def words(self, text: str, left: float, top: float, size: float = 14, colour: tuple[int, int, int] = _INK) -> None:
        from PIL import ImageFont

        self.pen.text((left, top), text, colour, font=ImageFont.load_default(size))

    def lines(self, text: str, size: float = 14, colour: tuple[int, int, int] = _INK, width: int = 170) -> None:
        self.make_space()
        for line in textwrap.wrap(text, width)[:_MOST_LINES] or [""]:
            self.words(line, _EDGE, self.top, size, colour)
            self.top += round(size * 1.45)

    def heading(self, text: str) -> None:
        self.top += _GAP
        self.pen.line((_EDGE, self.top, _WIDTH - _EDGE, self.top), fill=_RULE)
        self.top += _GAP
        self.lines(text, 20)
        self.top += 4

    def png(self) -> bytes:
        buffer = io.BytesIO()
        self.image.crop((0, 0, _WIDTH, self.top + _EDGE)).save(buffer, "png")
        return buffer.getvalue()


def sheet(report: ShowReport) -> bytes:
    """Return everything that is shown as a PNG."""
    paper = _Paper()
    paper.lines(f"What {report.policy} sees", 30)
    paper.lines(f"{report.robot}, {report.action_type} control. Shown: {report.scene.origin}. {report.how}.", 14, _SOFT)
    for note in report.notes:
        paper.lines(note, 14, _ALARM)
    if report.views:
        paper.heading("Pictures")
        for view in report.views:
            _view(paper, view)
    _words(paper, report)
    if report.figures and paper.make_space():
        paper.heading("Robot")
        paper.lines(ROBOT, 14, _SOFT)
        left = float(_EDGE)
        for figure in report.figures:
            figure.draw(paper.pen, left, paper.top, 1.1)
            left += 1.1 * figure.width + 10
        paper.top += round(1.1 * max(figure.height for figure in report.figures))
    return paper.png()


ROBOT: Final = (
    "Grey: the joints of the state. Red, green, blue: x, y, z of the pose that the model reads. Violet: from where its "
    "numbers count. Orange: the way that is commanded, and the joints at its end."
)


def _words(paper: _Paper, report: ShowReport) -> None:
    """Write the tables and texts."""
    for vector in report.vectors:
        paper.heading(f"State: {vector.input}")
        paper.lines(vector.words, 14, _SOFT)
        _table(paper, formatting.HEADS, vector.numbers)
    for name, text in report.texts.items():
        paper.heading(f"Instruction: {name}")
        paper.lines(f"standard: {report.instruction!r}")
        paper.lines(f"model: {text!r}")
    if report.action:
        paper.heading("Action")
        paper.lines(f"{report.action_from}. {report.action_words}. First and last step.", 14, _SOFT)
        _table(paper, formatting.ACTION_HEADS, report.action)
    if report.witness:
        paper.heading("What the robot's kinematics says of model_io.samples")
        for sentence in report.witness:
            paper.lines(sentence)


def _view(paper: _Paper, view: ImageView) -> None:
    """Draw the camera's picture, what people would see, and the numbers."""
    if not paper.make_space():
        return
    titles = (f"camera: {view.camera}", f"model: {view.input} {formatting.when(view)}", "its numbers as they are")
    pictures = (view.taken, view.seen, view.raw)
    below = (" x ".join(map(str, view.taken.shape)), ", ".join(view.words), formatting.about(view))
    top = paper.top
    bottom = top
    for column, (title, picture, caption) in enumerate(zip(titles, pictures, below, strict=True)):
        left = _EDGE + column * (_PICTURE[0] + 30)
        paper.words(title, left, top, 15)
        made = _fitted(picture)
        paper.image.paste(made, (left, top + 22))
        lines = textwrap.wrap(caption, 46)[:_MOST_LINES]
        for number, line in enumerate(lines):
            paper.words(line, left, top + 26 + made.height + 16 * number, 12.5, _SOFT)
        bottom = max(bottom, top + 30 + made.height + 16 * len(lines))
    notes = [line for one in view.notes for line in textwrap.wrap(one, 42)]
    for number, note in enumerate(notes[:_MOST_LINES]):
        paper.words(note, _EDGE + 3 * (_PICTURE[0] + 30), top + 24 + 26 * number, 20, _ALARM)
    paper.top = bottom + _GAP


def _fitted(picture: np.ndarray) -> Image.Image:
    from PIL import Image

    made = Image.fromarray(picture)
    scale = min(_PICTURE[0] / made.width, _PICTURE[1] / made.height)
    size = (max(1, round(made.width * scale)), max(1, round(made.height * scale)))
    return made.resize(size, Image.Resampling.NEAREST if scale > 1 else Image.Resampling.BICUBIC)


def _table(paper: _Paper, heads: Sequence[str], numbers: Sequence[Number]) -> None:
    _row(paper, heads, _SOFT)
    for number in numbers:
        if not paper.make_space():
            return
        _row(paper, formatting.row(number), _INK)


def _row(paper: _Paper, cells: Sequence[str], colour: tuple[int, int, int]) -> None:
    lines = [textwrap.wrap(cell, max(4, width // 7))[:_MOST_LINES] for cell, width in zip(cells, _COLUMNS, strict=True)]
    left = _EDGE
    for cell, width in zip(lines, _COLUMNS, strict=True):
        for line_number, line in enumerate(cell):
            paper.words(line, left, paper.top + line_number * 16, 13, colour)
        left += width
    paper.top += _LINE + 16 * (max(map(len, lines)) - 1)
    paper.pen.line((_EDGE, paper.top - 2, _WIDTH - _EDGE, paper.top - 2), fill=_RULE)
