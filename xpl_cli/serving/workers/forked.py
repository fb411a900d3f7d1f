"""Worker processes that a fork server (`xpl.process.fork_server`) starts, with the libraries of the policy imported."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import struct
import subprocess
import sys
from typing import TYPE_CHECKING, Self

from xpl.process import fork_server, spawn
from xpl.process.child import SDK_START
from xpl.process.link import Channel, decode
from xpl_cli.isolation import processes

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl.process.link import Head
    from xpl_cli.isolation.isolation_settings import IsolationSettings

VARIABLE = "XPL_FORK_SERVER"
"""Environment variable of a server: its descriptor of a connection to a fork server."""
_CREDENTIALS = struct.Struct("3i")
_GONE = -signal.SIGKILL
"""Exit code where the fork server is gone."""


class ForkedProcess:
    """A forked process, with the interface of `asyncio.subprocess.Process` that workers use.

    Attributes:
        pid: its process id.
        stdout: what it prints.
        returncode: its exit code, None while it runs.
    """

    def __init__(self, pid: int, stdout: asyncio.StreamReader, life: socket.socket) -> None:
        self.pid, self.stdout = pid, stdout
        self.returncode: int | None = None
        self._life = life
        self._ended = asyncio.Event()

    async def wait(self) -> int:
        """Wait until it has ended, and return its exit code."""
        await self._ended.wait()
        return _GONE if self.returncode is None else self.returncode

    def note_end(self, code: int) -> None:
        """Take note of its exit code."""
        self.returncode = code
        self._ended.set()
        self._life.close()


class ForkServerConnection:
    """A connection to a fork server, for one process."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._channel = Channel(connection)

    @classmethod
    def inherited(cls) -> Self | None:
        """Return the connection that this process was given, once."""
        number = os.environ.pop(VARIABLE, None)
        return None if number is None else cls(socket.socket(fileno=int(number)))

    def preload(self, imported: Mapping[str, object]) -> None:
        """Have the fork server import modules: `modules` and `variables`."""
        with contextlib.suppress(OSError):  # it is gone: later processes are started in the usual way
            self._channel.send({"import": dict(imported)})

    async def start(
        self, module: str, descriptors: Sequence[int], variables: Mapping[str, str]
    ) -> ForkedProcess | None:
        """Start a process that runs a module of the SDK.

        Args:
            module: its `main` gets the descriptors.
            descriptors: of this process, which stay open here.
            variables: environment variables that differ from the fork server's.

        Returns:
            None if the fork server has imported nothing yet, or cannot be forked.
        """
        ours, theirs = socket.socketpair()
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        read, write = os.pipe()
        request = {"run": module, "arguments": [], "variables": dict(variables), "descriptors": len(descriptors)}
        try:
            # In a thread: it may still be importing.
            pid = await asyncio.to_thread(self._fork, request, [theirs.fileno(), write, *descriptors], ours)
        finally:
            theirs.close()
            os.close(write)
        if pid is None:
            ours.close()
            os.close(read)
            return None
        stdout = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(stdout), os.fdopen(read, "rb")
        )
        process = ForkedProcess(pid, stdout, ours)
        asyncio.get_running_loop().add_reader(self._socket, self._read_end, process)
        return process

    def _fork(self, request: Head, descriptors: list[int], life: socket.socket) -> int | None:
        """Return the process id of the new process as seen from this one."""
        with contextlib.suppress(OSError, EOFError):
            self._channel.send(request)
            if not self._receive()["forks"]:
                return None
            socket.send_fds(self._socket, [b"\0"], descriptors)
            _, ancillary, _, _ = life.recvmsg(1, socket.CMSG_SPACE(_CREDENTIALS.size))
            for level, kind, data in ancillary:
                if (level, kind) == (socket.SOL_SOCKET, socket.SCM_CREDENTIALS):
                    return int(_CREDENTIALS.unpack(data)[0])
        return None

    def _read_end(self, process: ForkedProcess) -> None:
        asyncio.get_running_loop().remove_reader(self._socket)
        try:
            code = int(self._receive()["code"])
        except (OSError, EOFError):
            code = _GONE
        process.note_end(code)

    def _receive(self) -> Head:
        message = self._channel.receive()
        if message is None:
            raise EOFError("the fork server is gone")
        head: Head = decode(message)[0]
        return head


class WorkerForkServer:
    """A fork server for the workers of one policy, in their isolation; it ends with this object.

    Args:
        python: interpreter of the policy.
        checkout: its folder.
        bounds: isolation of its workers.

    Attributes:
        pid: its process, above which its isolation may have others.

    Raises:
        UserError, OSError: if it cannot be isolated, or started.
    """

    def __init__(self, python: str, checkout: Path, bounds: IsolationSettings) -> None:
        with contextlib.ExitStack() as opened:
            isolation = opened.enter_context(bounds.isolate_adapter(checkout))
            environment = spawn.variables()
            self._control, theirs = socket.socketpair()
            opened.callback(self._control.close)
            with theirs:
                process = subprocess.Popen(
                    spawn.command(
                        python,
                        SDK_START + fork_server.START,
                        str(theirs.fileno()),
                        prefix=() if isolation is None else isolation.prefix,
                    ),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    pass_fds=[theirs.fileno()],
                    env=environment if isolation is None else isolation.environment(environment),
                    cwd=checkout,
                    start_new_session=True,
                )
            self.pid = process.pid
            opened.callback(_end, process)
            self._opened = opened.pop_all()

    @staticmethod
    def is_possible() -> bool:
        """Whether this system tells the process id of the other end of a socket, as only Linux does."""
        return sys.platform == "linux"

    @contextlib.contextmanager
    def connect(self) -> Iterator[socket.socket]:
        """Return a connection for the length of a `with` block; whoever gets its descriptor keeps it."""
        ours, theirs = socket.socketpair()
        with ours, theirs:
            with contextlib.suppress(OSError):  # it is gone, and the other end of the connection is closed
                socket.send_fds(self._control, [b"\0"], [theirs.fileno()])
            theirs.close()
            yield ours

    def close(self) -> None:
        """End it, and all that it forked."""
        self._opened.close()


def _end(process: subprocess.Popen[bytes]) -> None:
    processes.kill_tree(process.pid)
    process.wait()
