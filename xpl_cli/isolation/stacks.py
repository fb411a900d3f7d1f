"""Parse the stacks that `faulthandler` prints on SIGUSR1."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

STACKS_S: Final = 0.2
"""Time for printing stacks before a process is killed, s."""
_FRAME = re.compile(r'\s*File "(?P<file>.+)", line (?P<line>\d+) in (?P<name>.+)')
_THREAD = re.compile(r"(Current t|T)hread 0x[0-9a-f]+")


def innermost_frame(log: Iterable[str], folder: Path) -> str | None:
    """Return the innermost frame of the last printed stacks: file, line and function; None without any.

    Args:
        log: lines of output.
        folder: the adapter's folder; its own innermost frame is preferred to a library's.
    """
    stacks: list[list[str]] = []
    for line in log:
        if _THREAD.match(line):
            stacks.append([])
        elif stacks and (match := _FRAME.match(line)):
            file = Path(match["file"])
            own = file.is_relative_to(folder)
            name = file.relative_to(folder) if own else file.name
            stacks[-1].append(f"{'' if own else ' '}{name}:{match['line']} in {match['name']}")
    frames = [frame for stack in reversed(stacks) for frame in stack]  # the main thread is last
    return next((frame for frame in frames if frame[0] != " "), None)
