"""Worker processes that a fork server starts, with the libraries of the policy imported."""

from __future__ import annotations

import asyncio
import os
import socket
from typing import TYPE_CHECKING, Self

from xpl_cli.isolation.forks import ForkConnection

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from xpl_cli.isolation.forks import Forked

VARIABLE = "XPL_FORK_SERVER"
"""Environment variable of a server: its descriptor of a connection to a fork server."""


class ForkedProcess:
    """A forked process, with the interface of `asyncio.subprocess.Process` that workers use.

    Attributes:
        pid: its process id.
        stdout: what it prints.
    """

    def __init__(self, forked: Forked, stdout: asyncio.StreamReader) -> None:
        self.pid, self.stdout = forked.pid, stdout
        self._forked = forked
        self._ended = asyncio.Event()
        asyncio.get_running_loop().add_reader(forked.connection.socket, self._note_end)

    @property
    def returncode(self) -> int | None:
        """Its exit code, None while it runs."""
        return self._forked.returncode

    async def wait(self) -> int:
        """Wait until it has ended, and return its exit code."""
        await self._ended.wait()
        return self._forked.wait()

    def _note_end(self) -> None:
        asyncio.get_running_loop().remove_reader(self._forked.connection.socket)
        self._forked.wait()
        self._ended.set()


class WorkerForks(ForkConnection):
    """A server's connection to the fork server of its worker."""

    @classmethod
    def inherited(cls) -> Self | None:
        """Return the connection that this process was given, once."""
        number = os.environ.pop(VARIABLE, None)
        return None if number is None else cls(socket.socket(fileno=int(number)))

    async def start(
        self, module: str, descriptors: Sequence[int], variables: Mapping[str, str], cwd: Path
    ) -> ForkedProcess | None:
        """Start a process; see `fork`."""
        read, write = os.pipe()
        request = {"run": module, "arguments": [], "variables": dict(variables), "cwd": str(cwd)}
        with open(os.devnull, "rb") as nothing:  # noqa: PTH123, ASYNC230 - a device
            try:  # in a thread: the fork server may still be importing
                forked = await asyncio.to_thread(self.fork, request, nothing.fileno(), write, descriptors)
            finally:
                os.close(write)
        if forked is None:
            os.close(read)
            return None
        stdout = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(stdout), os.fdopen(read, "rb")
        )
        return ForkedProcess(forked, stdout)
