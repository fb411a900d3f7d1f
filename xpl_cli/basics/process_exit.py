"""Wait for the exit of an asyncio process, also while other processes hold its pipes.

`asyncio.subprocess.Process.wait` returns, in some releases of Python 3.11 and 3.12, only when the pipes of the process
are closed (cpython#119710). A child that outlives it would hide its exit.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from typing import Protocol

_SOON_S = 0.005


class EndingProcess(Protocol):
    """What `asyncio.subprocess.Process` has that matters here."""

    @property
    def pid(self) -> int:
        """Its process id."""

    @property
    def returncode(self) -> int | None:
        """Its exit code, None while it runs."""

    async def wait(self) -> int:
        """Wait until it has ended."""


async def exit_code(process: EndingProcess) -> int:
    """Wait for a process to end, and return its exit code, or the negative number of the signal that ended it."""
    if process.returncode is None and hasattr(os, "pidfd_open"):
        with contextlib.suppress(ProcessLookupError):  # it has ended, and asyncio is about to notice
            try:
                handle = os.pidfd_open(process.pid)
            except PermissionError:  # refused by a container's seccomp filter
                return await process.wait()
            await _readable(handle)
        while process.returncode is None:  # noqa: ASYNC110 - asyncio has no event for it
            await asyncio.sleep(_SOON_S)
    return process.returncode if process.returncode is not None else await process.wait()


async def _readable(handle: int) -> None:
    """Wait until a descriptor is readable, and close it."""
    loop = asyncio.get_running_loop()
    ready: asyncio.Future[None] = loop.create_future()
    loop.add_reader(handle, _tell, ready)
    try:
        await ready
    finally:
        loop.remove_reader(handle)
        os.close(handle)


def _tell(ready: asyncio.Future[None]) -> None:
    if not ready.done():
        ready.set_result(None)
