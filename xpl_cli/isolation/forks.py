"""Processes that are forked from one that has imported a policy's libraries (`xpl.process.fork_server`)."""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import socket
import struct
import subprocess
import sys
from typing import IO, TYPE_CHECKING

from xpl.process import fork_server, spawn
from xpl.process.child import SDK_START
from xpl.process.link import Channel
from xpl_cli.isolation import processes

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl_cli.isolation.isolation_settings import IsolationSettings

_CREDENTIALS = struct.Struct("3i")
_GONE = -signal.SIGKILL
"""Exit code where the fork server is gone."""


class AdapterForkServer:
    """A fork server for the processes of one policy, in their isolation; it ends with this object.

    Args:
        python: interpreter of the policy.
        checkout: its folder.
        bounds: isolation of its processes.

    Attributes:
        pid: its process, above which its isolation may have others.
        folder: the writable folder of full isolation; None without.
        checkout: folder of the policy.

    Raises:
        UserError, OSError: if it cannot be isolated, or started.
    """

    def __init__(self, python: str, checkout: Path, bounds: IsolationSettings) -> None:
        with contextlib.ExitStack() as opened:
            isolation = opened.enter_context(bounds.isolate_adapter(checkout))
            self.folder = None if isolation is None else isolation.folder
            self.checkout = checkout
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
        """Return a connection for the length of a `with` block; a process that gets its descriptor keeps it."""
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


class ForkConnection:
    """A connection to a fork server, for one process; blocks."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self._channel = Channel(connection)

    def preload(self, imported: Mapping[str, object]) -> None:
        """Have the fork server import modules: `modules` and `variables`."""
        with contextlib.suppress(OSError):  # it is gone: later processes are started in the usual way
            self._channel.send({"import": dict(imported)})

    def fork(self, request: Mapping[str, object], stdin: int, output: int, descriptors: Sequence[int]) -> Forked | None:
        """Start a process.

        Args:
            request: `run`, a module of the SDK, `arguments` of its `main`, and `variables` of the environment that
                differ from the fork server's, and `cwd`, its working directory.
            stdin: descriptor of its standard input.
            output: descriptor for what it prints.
            descriptors: further arguments of `main`; like the others, they stay open here.

        Returns:
            None if the fork server has imported nothing yet, or cannot be forked.
        """
        ours, theirs = socket.socketpair()
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        with theirs, contextlib.suppress(OSError, EOFError):
            self._channel.send({**request, "descriptors": len(descriptors)})
            if self._channel.receive_head()["forks"]:
                socket.send_fds(self.socket, [b"\0"], [theirs.fileno(), stdin, output, *descriptors])
                _, ancillary, _, _ = ours.recvmsg(1, socket.CMSG_SPACE(_CREDENTIALS.size))
                for level, kind, data in ancillary:
                    if (level, kind) == (socket.SOL_SOCKET, socket.SCM_CREDENTIALS):
                        return Forked(int(_CREDENTIALS.unpack(data)[0]), ours, self)
        ours.close()
        return None

    def exit_code(self) -> int:
        """Wait until the process has ended, and return its exit code."""
        try:
            return int(self._channel.receive_head()["code"])
        except (OSError, EOFError):
            return _GONE


class Forked:
    """A forked process, with the interface of `subprocess.Popen` that matters here.

    Attributes:
        pid: its process id.
        stdin: its standard input, where it is a pipe.
        returncode: its exit code, None until it was waited for.
    """

    def __init__(self, pid: int, life: socket.socket, connection: ForkConnection) -> None:
        self.pid = pid
        self.stdin: IO[bytes] | None = None
        self.returncode: int | None = None
        self.connection = connection
        self._life = life

    def end(self) -> None:
        """Kill it, and all that it started."""
        self._life.close()

    def wait(self, timeout: float | None = None) -> int:
        """Wait until it has ended, and return its exit code.

        Raises:
            subprocess.TimeoutExpired: if it has not ended within `timeout` seconds.
        """
        if self.returncode is None:
            with selectors.DefaultSelector() as selector:
                selector.register(self.connection.socket, selectors.EVENT_READ)
                if not selector.select(timeout):
                    raise subprocess.TimeoutExpired(["python"], timeout or 0.0)
            self.returncode = self.connection.exit_code()
            self.end()
            self.connection.socket.close()
        return self.returncode


def run_forked(
    forks: AdapterForkServer, module: str, arguments: Sequence[str], output: IO[bytes], stdin: int = subprocess.DEVNULL
) -> Forked | None:
    """Start a process that runs a module of the SDK.

    Args:
        forks: what forks it.
        module: the module.
        arguments: of its `main`.
        output: gets what it prints.
        stdin: `subprocess.DEVNULL` or `subprocess.PIPE`.

    Returns:
        None if it must be started in the usual way.
    """
    read, write = os.pipe()
    with os.fdopen(read, "rb"), contextlib.ExitStack() as opened:
        pipe = opened.enter_context(os.fdopen(write, "wb"))
        with forks.connect() as connection:
            own = ForkConnection(connection.dup())
        opened.callback(own.socket.close)
        forked = own.fork(
            {"run": module, "arguments": list(arguments), "variables": {}, "cwd": str(forks.checkout)},
            read,
            output.fileno(),
            [],
        )
        if forked is not None:
            opened.pop_all()
            if stdin == subprocess.PIPE:
                forked.stdin = pipe
            else:
                pipe.close()
    return forked
