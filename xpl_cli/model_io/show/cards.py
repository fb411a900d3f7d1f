"""Test cards: pictures on which people see at a glance that colours, sides or cameras are exchanged.

Each says in words what it is: the camera's name, R in red, G in green, B in blue, an arrow upwards, left and right, and
how long ago it was. Every camera has a ground of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

_GROUNDS = ((232, 226, 208), (206, 226, 214), (214, 214, 236), (236, 214, 222))
"""By camera; nearly grey, so that the letters' colours are the only strong ones."""
_INK = (28, 30, 34)
_LETTERS = (("R", (214, 32, 32)), ("G", (24, 150, 48)), ("B", (28, 64, 220)))


def card(camera: str, number: int, height: int, width: int, when: str = "now") -> np.ndarray:
    """Return a test card, (height, width, 3) uint8 RGB.

    Args:
        camera: its name in the standard.
        number: of the camera, which decides its ground.
        height: pixels.
        width: pixels.
        when: of which moment, such as `now` or `3 steps ago`.
    """
    from PIL import Image, ImageDraw

    paper = Image.new("RGB", (width, height), _GROUNDS[number % len(_GROUNDS)])
    pen = _Pen(ImageDraw.Draw(paper), width, height)
    pen.letters()
    pen.arrow()
    words = camera.removeprefix("cam_").replace("_", " ").upper()
    size = min(height, width)
    pen.words(words, (0.5, 0.56), min(0.15 * size, 1.5 * width / max(len(words), 1)))
    pen.words(when, (0.5, 0.72), 0.08 * size)
    pen.words("left", (0.03, 0.9), 0.1 * size, anchor="lm")
    pen.words("right", (0.97, 0.9), 0.1 * size, anchor="rm")
    pen.draw.rectangle((0, 0, width - 1, height - 1), outline=_INK, width=max(1, round(0.012 * size)))
    return np.asarray(paper).copy()


@dataclass(frozen=True)
class _Pen:
    """Draws on a card of a size; places are shares of it."""

    draw: ImageDraw
    width: int
    height: int

    def letters(self) -> None:
        """Draw R, G and B on fields of their colours."""
        side = 0.26 * min(self.width, self.height)
        top = 0.07 * self.height
        for column, (letter, colour) in enumerate(_LETTERS):
            left = 0.05 * self.width + column * 1.12 * side
            self.draw.rectangle((left, top, left + side, top + side), fill=colour)
            middle = ((left + side / 2) / self.width, (top + side / 2) / self.height)
            self.words(letter, middle, 0.8 * side, fill=(255, 255, 255))

    def arrow(self) -> None:
        """Draw an arrow upwards, with the word."""
        size = 0.26 * min(self.width, self.height)
        middle, top = 0.95 * self.width - size / 2, 0.07 * self.height
        neck = top + size / 2
        self.draw.polygon([(middle, top), (middle - size / 2, neck), (middle + size / 2, neck)], fill=_INK)
        self.draw.rectangle((middle - 0.13 * size, neck, middle + 0.13 * size, top + size), fill=_INK)
        self.words("up", (middle / self.width, (top + 1.25 * size) / self.height), 0.35 * size)

    def words(
        self,
        words: str,
        at: tuple[float, float],
        size: float,
        *,
        anchor: str = "mm",
        fill: tuple[int, int, int] = _INK,
    ) -> None:
        """Write words of a size, pixels, at a place."""
        from PIL import ImageFont

        position = at[0] * self.width, at[1] * self.height
        self.draw.text(position, words, fill, font=ImageFont.load_default(max(6, size)), anchor=anchor)
