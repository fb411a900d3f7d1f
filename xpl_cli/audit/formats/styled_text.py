"""Text for a terminal: pieces with a style, wrapped between words and coloured if the terminal supports it.

A text report is printed at the end of every audit; importing a full library for this would take longer than the static
gate.
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
class OutputStyle:
    """Width and colours of an output stream.

    Attributes:
        width: columns; None if lines are not wrapped, as in a file.
        colour: whether styles are shown.
        height: lines; None if that is not known.
    """

    width: int | None = None
    colour: bool = False
    height: int | None = None

    @classmethod
    def of(cls, stream: TextIO) -> Self:
        """Return the style of a stream. `NO_COLOR` and `FORCE_COLOR` (no-color.org, force-color.org) decide first."""
        is_terminal = stream.isatty()
        colour = is_terminal and os.environ.get("TERM") != "dumb"
        if os.environ.get("NO_COLOR"):
            colour = False
        elif os.environ.get("FORCE_COLOR"):
            colour = True
        size = shutil.get_terminal_size() if is_terminal else None
        return cls(size.columns, colour, size.lines) if size is not None else cls(None, colour)


@dataclass
class StyledText:
    """Text in pieces, each with a style such as `bold red`; may hold several lines.

    Attributes:
        wraps: whether its lines may be wrapped; commands to paste are not.
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
        """Return the number of terminal lines that it needs."""
        return 1 + self.plain.count("\n") + len(self._breaks(width))

    def render(self, terminal: OutputStyle) -> str:
        """Return the text with wrapping and colours for a terminal."""
        breaks = self._breaks(terminal.width) if self.wraps and terminal.width is not None else {}
        written, offset_of_piece = [], 0
        for text, style in self._pieces:
            codes = [str(_CODES[word]) for word in style.split()] if terminal.colour else []
            piece = "".join(breaks.get(offset_of_piece + offset, character) for offset, character in enumerate(text))
            written.append(f"\x1b[{';'.join(codes)}m{piece}\x1b[0m" if codes and piece else piece)
            offset_of_piece += len(text)
        return "".join(written)

    def _breaks(self, width: int) -> dict[int, str]:
        """Return the offsets of spaces that become line ends, with the line end and the indent after it."""
        breaks: dict[int, str] = {}
        start = 0
        for line in self.plain.split("\n"):
            indent = min(len(line) - len(line.lstrip(" ")) + 2, width // 2)
            column = 0
            for word in re.finditer(r" *[^ ]+", line):
                spaces = len(word.group()) - len(word.group().lstrip(" "))
                size = sum(map(_cells, word.group()))
                if spaces and word.start() > 0 and column + size > width:
                    # The last of several spaces becomes the line end; the others stay at the end of the line.
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
