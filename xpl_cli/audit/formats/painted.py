"""Text for a terminal: pieces with a style, wrapped between words and coloured where that is wanted.

A report for people is printed at the end of every audit; a library that can do far more than this takes longer to
import than the static gate takes to run.
"""

from __future__ import annotations

import os
import re
import shutil
import unicodedata
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from typing import TextIO

_CODES: Final = {"bold": 1, "dim": 2, "red": 31, "green": 32, "yellow": 33, "magenta": 35, "cyan": 36}
"""Parameters of the control sequence Select Graphic Rendition (ECMA-48, 8.3.117)."""


@dataclass(frozen=True)
class Terminal:
    """What output goes to.

    Attributes:
        width: columns; None where lines are not wrapped, as in a file.
        colour: whether styles are shown.
    """

    width: int | None = None
    colour: bool = False

    @classmethod
    def of(cls, stream: TextIO) -> Self:
        """Return what a stream leads to. `NO_COLOR` and `FORCE_COLOR` (no-color.org, force-color.org) decide first."""
        is_terminal = stream.isatty()
        colour = is_terminal and os.environ.get("TERM") != "dumb"
        if os.environ.get("NO_COLOR"):
            colour = False
        elif os.environ.get("FORCE_COLOR"):
            colour = True
        return cls(shutil.get_terminal_size().columns if is_terminal else None, colour)


@dataclass
class Painted:
    """Text in pieces, each with a style such as `bold red`; may hold several lines.

    Attributes:
        wraps: whether its lines may be broken; those of commands that are to be pasted may not.
    """

    wraps: bool = True
    _pieces: list[tuple[str, str]] = field(default_factory=list)

    @classmethod
    def of(cls, *pieces: str | tuple[str, str]) -> Self:
        """Return the text of these pieces, with or without a style."""
        text = cls()
        for piece in pieces:
            text.append(*((piece,) if isinstance(piece, str) else piece))
        return text

    @property
    def plain(self) -> str:
        """The text without styles."""
        return "".join(text for text, _ in self._pieces)

    def append(self, text: str, style: str = "") -> Self:
        """Add a piece."""
        self._pieces.append((text, style))
        return self

    def height(self, width: int) -> int:
        """Return how many lines of a terminal it takes."""
        return 1 + self.plain.count("\n") + len(self._breaks(width))

    def shown(self, terminal: Terminal) -> str:
        """Return the text as it is to be written."""
        breaks = self._breaks(terminal.width) if self.wraps and terminal.width is not None else {}
        written, place = [], 0
        for text, style in self._pieces:
            codes = [str(_CODES[word]) for word in style.split()] if terminal.colour else []
            piece = "".join(breaks.get(place + offset, character) for offset, character in enumerate(text))
            written.append(f"\x1b[{';'.join(codes)}m{piece}\x1b[0m" if codes and piece else piece)
            place += len(text)
        return "".join(written)

    def _breaks(self, width: int) -> dict[int, str]:
        """Return the places of spaces that have to become line ends, with the line end and the indent after it."""
        breaks: dict[int, str] = {}
        start = 0
        for line in self.plain.split("\n"):
            indent = min(len(line) - len(line.lstrip(" ")) + 2, width // 2)
            column = 0
            for word in re.finditer(r" *[^ ]+", line):
                spaces = len(word.group()) - len(word.group().lstrip(" "))
                size = sum(map(_cells, word.group()))
                if spaces and word.start() > 0 and column + size > width:
                    # The last of several spaces becomes the line end; those before it are behind the last word.
                    breaks[start + word.start() + spaces - 1] = "\n" + " " * indent
                    column, size = indent, size - spaces
                column += size
            start += len(line) + 1
        return breaks


def _cells(character: str) -> int:
    """Return how many columns a character takes (UAX #11)."""
    if character.isascii():
        return 1
    if unicodedata.combining(character):
        return 0
    return 2 if unicodedata.east_asian_width(character) in {"W", "F"} else 1
