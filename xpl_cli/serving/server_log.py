"""The server's log on standard error: each entry begins with `[server]`, also where it holds untrusted text."""

from __future__ import annotations

import contextlib
import sys
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_MAX_CHARACTERS = 1 << 16
"""Longest entry: a client that causes log entries controls neither their number nor their length."""
_WINDOW_S = 60.0


def log(text: str) -> None:
    """Write an entry of one line; line breaks and escape sequences in it are escaped."""
    _write(_escape_unprintable(text[:_MAX_CHARACTERS]))


def log_lines(text: str) -> None:
    """Write an entry of several lines, such as a traceback; each further line begins with `[server] |`."""
    _write("\n[server] | ".join(map(_escape_unprintable, text[:_MAX_CHARACTERS].rstrip("\n").split("\n"))))


def _write(text: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # a full disk or a closed pipe does not end the server
        sys.stderr.write(f"[server] {text}\n")
        sys.stderr.flush()


def _escape_unprintable(text: str) -> str:
    r"""Return a text on one line, with everything unprintable escaped, such as `\n`, `\x1b` or `\u202e`.

    Control characters, line separators, marks of writing direction, characters without width and lone surrogates count.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode("ascii") for char in text)


class RateLimitedLog:
    """Log of a repeated event: at most so many entries per minute; the rest is counted.

    Args:
        text: the event.
        max_per_minute: entries per minute.
        clock: the time, s.
    """

    def __init__(self, text: str, max_per_minute: int = 1, clock: Callable[[], float] = time.monotonic) -> None:
        self._text = text
        self._max_per_minute = max_per_minute
        self._clock = clock
        self._window_start = -_WINDOW_S
        self._logged = 0
        self._suppressed = 0

    def log(self, detail: str = "", lines: str = "") -> None:
        """Log the event once more, with further lines such as a traceback; count it if the limit is reached."""
        now = self._clock()
        if now - self._window_start >= _WINDOW_S:
            self._window_start, self._logged = now, 0
        if self._logged >= self._max_per_minute:
            self._suppressed += 1
            return
        more = f" ({self._suppressed} more since the last entry)" if self._suppressed else ""
        log(self._text + (f": {detail}" if detail else "") + more)
        if lines:
            log_lines(lines)
        self._logged, self._suppressed = self._logged + 1, 0
