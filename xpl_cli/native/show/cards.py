"""Test cards: pictures on which people see at a glance that colours, sides or cameras are exchanged.

Each says in words what it is: the camera's name, R in red, G in green, B in blue, an arrow upwards, left and right, and
how long ago it was. Every camera has a ground of its own.
"""

from __future__ import annotations

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
    pen = ImageDraw.Draw(paper)
    size = min(height, width)
    _letters(pen, width, height)
    _arrow(pen, width, height)
    words = camera.removeprefix("cam_").replace("_", " ").upper()
    _text(pen, words, (width / 2, 0.56 * height), min(0.15 * size, 1.5 * width / max(len(words), 1)))
    _text(pen, when, (width / 2, 0.72 * height), 0.08 * size)
    _text(pen, "left", (0.03 * width, 0.9 * height), 0.1 * size, "lm")
    _text(pen, "right", (0.97 * width, 0.9 * height), 0.1 * size, "rm")
    pen.rectangle((0, 0, width - 1, height - 1), outline=_INK, width=max(1, round(0.012 * size)))
    return np.asarray(paper).copy()


def _letters(pen: ImageDraw, width: int, height: int) -> None:
    """Draw R, G and B on fields of their colours."""
    side = 0.26 * min(width, height)
    for place, (letter, colour) in enumerate(_LETTERS):
        left, top = 0.05 * width + place * 1.12 * side, 0.07 * height
        pen.rectangle((left, top, left + side, top + side), fill=colour)
        _text(pen, letter, (left + side / 2, top + side / 2), 0.8 * side, fill=(255, 255, 255))


def _arrow(pen: ImageDraw, width: int, height: int) -> None:
    size = 0.26 * min(width, height)
    middle, top = 0.95 * width - size / 2, 0.07 * height
    pen.polygon([(middle, top), (middle - size / 2, top + 0.5 * size), (middle + size / 2, top + 0.5 * size)], fill=_INK)
    pen.rectangle((middle - 0.13 * size, top + 0.5 * size, middle + 0.13 * size, top + size), fill=_INK)
    _text(pen, "up", (middle, top + 1.25 * size), 0.35 * size)


def _text(
    pen: ImageDraw,
    words: str,
    at: tuple[float, float],
    size: float,
    anchor: str = "mm",
    fill: tuple[int, int, int] = _INK,
) -> None:
    from PIL import ImageFont

    pen.text(at, words, fill, font=ImageFont.load_default(max(6, size)), anchor=anchor)
