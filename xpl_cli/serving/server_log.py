"""The server's log, which is standard error: each entry begins with `[server]`, whatever strangers had it say."""

from __future__ import annotations

import contextlib
import sys
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_LONGEST = 1 << 16
"""Characters of an entry: whoever makes the server complain decides neither how often nor at what length."""
_QUIET_S = 60.0


def log(text: str) -> None:
    """Write an entry of one line; line breaks and escape sequences in it are written out."""
    _write(_visible(text[:_LONGEST]))


def log_lines(text: str) -> None:
    """Write an entry of several lines, such as a traceback; those that follow the first are marked as such."""
    _write("\n[server] | ".join(map(_visible, text[:_LONGEST].rstrip("\n").split("\n"))))


def _write(text: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # a full disk, or a reader that is gone: no reason to end
        sys.stderr.write(f"[server] {text}\n")
        sys.stderr.flush()


def _visible(text: str) -> str:
    r"""Return a text on one line, with everything that is not printed written out, such as `\n`, `\x1b` or `\u202e`.

    Control characters, line separators, marks of writing direction, characters without width and lone surrogates count.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode("ascii") for char in text)


class RateLimitedLog:
    """Says once what happens many times: at once, and then a minute later how often since.

    Args:
        text: what happens.
        most: how often it is said in a minute.
        clock: the time, s.
    """

    def __init__(self, text: str, most: int = 1, clock: Callable[[], float] = time.monotonic) -> None:
        self._text = text
        self._most = most
        self._clock = clock
        self._begun = -_QUIET_S
        self._told = 0
        self._untold = 0

    def note(self, detail: str = "", lines: str = "") -> None:
        """Take note of one more; further lines, such as a traceback, are told with it."""
        now = self._clock()
        if now - self._begun >= _QUIET_S:
            self._begun, self._told = now, 0
        if self._told >= self._most:
            self._untold += 1
            return
        more = f" ({self._untold} more since this was last said)" if self._untold else ""
        log(self._text + (f": {detail}" if detail else "") + more)
        if lines:
            log_lines(lines)
        self._told, self._untold = self._told + 1, 0
