"""Start and end of a child process: link, command, variables, process group, exit code."""

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
"""Offset that a launcher adds to the number of the signal that ended its child."""


def link() -> tuple[socket.socket, socket.socket]:
    """Return both ends of a link, the parent's first."""
    ends = socket.socketpair()
    for end in ends:
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            end.setsockopt(socket.SOL_SOCKET, option, _BUFFER)
    return ends


def command(python: str, start: str, *arguments: str, prefix: Sequence[str] = ()) -> list[str]:
    """Return the command of a process that runs code of the SDK.

    Args:
        python: interpreter; it needs numpy, not the SDK.
        start: its code: `child.SDK_START`, which reads the first argument, and more.
        arguments: further arguments; usually the number of its end of the link.
        prefix: put before the command, for an isolation.
    """
    return [*prefix, python, "-c", start, str(Path(child.__file__).parents[1]), *arguments]


def variables(environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment variables of a process with its own interpreter, without this one's path settings."""
    env = {**(os.environ if environment is None else environment), "PYTHONUNBUFFERED": "1"}
    env.pop("PYTHONHOME", None)
    return env


def describe_exit(code: int, *, launched: bool = False) -> str:
    """Return a phrase about how a process ended.

    Args:
        code: exit code; negative: the number of the signal that ended it.
        launched: whether a launcher, such as an isolation, passed the code on.
    """
    if launched and code > _SIGNALLED:
        code = _SIGNALLED - code
    if code >= 0:
        return f"ended with exit code {code}"
    names = {number.value: number.name for number in signal.Signals}
    return f"was ended by signal {names.get(-code, -code)}"


def end_group(leader: int) -> None:
    """Kill the process group of `leader`; one that has ended is ignored."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)
