"""How a process of ours is started and ended: its link, command, variables and group, and what its exit code says."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path

from xpl.process import child

_BUFFER = 1 << 22
_SIGNALLED = 128
"""What a launcher adds to the number of the signal that ended what it had started."""


def link() -> tuple[socket.socket, socket.socket]:
    """Return both ends of a link, ours first."""
    ends = socket.socketpair()
    for end in ends:
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            end.setsockopt(socket.SOL_SOCKET, option, _BUFFER)
    return ends


def command(python: str, start: str, *arguments: str, prefix: Sequence[str] = ()) -> list[str]:
    """Return the command of a process that runs code of the SDK.

    Args:
        python: interpreter; it needs numpy, and not the SDK.
        start: what it runs: `child.SDK_START`, which takes the first argument, and more.
        arguments: the further ones; for most the number of their end of the link.
        prefix: what is put before the command, as an isolation has it.
    """
    return [*prefix, python, "-c", start, str(Path(child.__file__).parents[1]), *arguments]


def variables(environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the variables of a process with an interpreter of its own: our path settings must not leak into it."""
    found = {**(os.environ if environment is None else environment), "PYTHONUNBUFFERED": "1"}
    found.pop("PYTHONHOME", None)
    return found


def how_it_ended(code: int, *, launched: bool = False) -> str:
    """Return in words how a process ended.

    Args:
        code: its exit code; minus the number of a signal that ended it.
        launched: whether a launcher gave the code on, as an isolation has one.
    """
    if launched and code > _SIGNALLED:
        code = _SIGNALLED - code
    if code >= 0:
        return f"ended with exit code {code}"
    names = {number.value: number.name for number in signal.Signals}
    return f"was ended by signal {names.get(-code, -code)}"


def end_group(leader: int) -> None:
    """Kill a process that leads a group, and the group; who has ended stays ended."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)
