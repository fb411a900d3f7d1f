"""Where a process stands, as `faulthandler` prints it on SIGUSR1."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

STACKS_S: Final = 0.2
"""Time that a process has to print its stacks before it is killed, s."""
_FRAME = re.compile(r'\s*File "(?P<file>.+)", line (?P<line>\d+) in (?P<name>.+)')
_THREAD = re.compile(r"(Current t|T)hread 0x[0-9a-f]+")


def innermost_frame(log: Iterable[str], folder: Path) -> str | None:
    """Return where an adapter stood when it printed its stacks last: file, line and function; None if it did not.

    Args:
        log: lines of output, with what `faulthandler` prints.
        folder: the adapter's; its own innermost line counts for more than a library's.
    """
    stacks: list[list[str]] = []
    for line in log:
        if _THREAD.match(line):
            stacks.append([])
        elif stacks and (found := _FRAME.match(line)):
            file = Path(found["file"])
            own = file.is_relative_to(folder)
            shown = file.relative_to(folder) if own else file.name
            stacks[-1].append(f"{'' if own else ' '}{shown}:{found['line']} in {found['name']}")
    frames = [frame for stack in reversed(stacks) for frame in stack]  # the main thread comes last
    return next((frame for frame in frames if frame[0] != " "), None)
