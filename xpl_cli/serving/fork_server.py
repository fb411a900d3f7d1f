"""A fork server for policy servers: a process that has imported all modules, so that a fork starts in half the time.

Imports take half of the start of a policy server, and an audit starts dozens of servers. The fork server is a process
without threads that gets requests over a private socket, each with the descriptors of the new server's standard
streams. It starts with the first request and ends with the process that started it.

    -> {"arguments": [...], "cwd": "/...", "environment": {...}, "limits": [...], "given": null}
    <- {"wants": 4}
    -> one byte, with four descriptors: streams, and one to hold open; a fifth where `given` names the variable in which
       the process finds its number
    <- {"pid": 123}
    -> {"status": 123}      once the process has let go of the fourth descriptor
    <- {"code": 0}
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import importlib
import os
import resource
import runpy
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Final, NoReturn

import xpl_cli
from xpl.process.link import Channel, Head

_PRELOADED: Final = (
    "xpl_cli.main",
    "xpl_cli.commands.run.serve",
    "xpl_cli.serving.run",
    "xpl_cli.serving.front_end",
    "xpl_cli.isolation.sandbox",
    "encodings.idna",
    "encodings.utf_8_sig",
)
_SCHEMAS: Final = ("policy", "deploy")
"""Schemas of the manifests that every server reads."""
_START: Final = (
    "import sys; sys.path.insert(0, sys.argv[1]); from xpl_cli.serving.fork_server import main; main(int(sys.argv[2]))"
)
_LIMITS: Final = frozenset(number for name, number in vars(resource).items() if name.startswith("RLIMIT_"))
_STREAMS: Final = 3
_UNKNOWN: Final = -signal.SIGKILL
"""Exit code of a server whose fork server is gone."""


class ForkedServer:
    """A forked `xpl` process, with the interface of `subprocess.Popen`.

    Attributes:
        pid: the process, which leads a session of its own.
        stdin, stdout, stderr: this process's ends of its standard streams.
        returncode: its exit code, None while it runs.
    """

    def __init__(self, fork_server: ForkServer, pid: int, streams: Sequence[IO[bytes]], life: int) -> None:
        self.pid = pid
        self.stdin, self.stdout, self.stderr = streams
        self.returncode: int | None = None
        self._fork_server = fork_server
        self._life = life
        self._lock = threading.Lock()

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait until it has ended, and return its exit code.

        Raises:
            subprocess.TimeoutExpired: if it has not ended within `timeout` seconds.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._lock:
            if self.returncode is None:
                left = None if deadline is None else max(0.0, deadline - time.monotonic())
                if not _is_readable(self._life, left):
                    raise subprocess.TimeoutExpired(["xpl"], timeout or 0.0)
                os.close(self._life)
                self.returncode = self._fork_server.status(self.pid)
            return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)


class ForkServer:
    """The client side of the fork server.

    Args:
        start: code of the process; its arguments are the folder of `xpl_cli` and the descriptor of its socket.
    """

    def __init__(self, start: str = _START) -> None:
        self._lock = threading.Lock()
        self._channel, theirs = socket.socketpair()
        self._link = Channel(self._channel)
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}  # only a process without threads can be forked
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", start, str(Path(xpl_cli.__file__).parents[1]), str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env=environment,
                start_new_session=True,
            )

    def start(self, arguments: Sequence[str], given: tuple[str, int] | None = None) -> ForkedServer:
        """Start `xpl` with arguments, in this process's working directory, environment and limits as they are now.

        Args:
            arguments: of the command line.
            given: a descriptor for the process, after the environment variable in which it finds its number.

        Raises:
            OSError, EOFError: if the fork server is gone.
        """
        request = {
            "arguments": list(arguments),
            "cwd": str(Path.cwd()),
            "environment": dict(os.environ),
            "limits": [(number, resource.getrlimit(number)) for number in _LIMITS],
            "given": None if given is None else given[0],
        }
        pipes = [os.pipe() for _ in range(_STREAMS + 1)]
        (stdin, to_stdin), *outputs = pipes
        theirs = [stdin, *(write for _, write in outputs)]
        ours = [to_stdin, *(read for read, _ in outputs)]
        try:
            further = [] if given is None else [given[1]]
            pid = int(self._exchange(request, [*theirs, *further])["pid"])
        except BaseException:
            for descriptor in ours:
                os.close(descriptor)
            raise
        finally:
            for descriptor in theirs:
                os.close(descriptor)
        streams: list[IO[bytes]] = [os.fdopen(ours[0], "wb"), os.fdopen(ours[1], "rb"), os.fdopen(ours[2], "rb")]
        return ForkedServer(self, pid, streams, ours[3])

    def status(self, pid: int) -> int:
        """Return the exit code of a process that has ended."""
        try:
            return int(self._exchange({"status": pid})["code"])
        except (OSError, EOFError):
            return _UNKNOWN

    def close(self) -> None:
        """End the fork server; forked processes continue."""
        self._channel.close()
        self._process.wait()

    def _exchange(self, request: Head, descriptors: Sequence[int] = ()) -> Head:
        with self._lock:
            self._link.send(request)
            if descriptors:
                self._link.receive_head()  # the lock prevents other reads, which would lose the descriptors
                socket.send_fds(self._channel, [b"\0"], list(descriptors))
            return self._link.receive_head()


_LOCK = threading.Lock()


@functools.cache
def _fork_server(_pid: int) -> ForkServer:
    """Return the fork server of this process; a forked process creates its own."""
    server = ForkServer()
    atexit.register(server.close)
    return server


def warm() -> None:
    """Start the fork server now, in the current environment, instead of with the first request."""
    with _LOCK:
        _fork_server(os.getpid())


def start(arguments: Sequence[str], given: tuple[str, int] | None = None) -> ForkedServer:
    """Start `xpl` with arguments in a process of its own; see `ForkServer.start`.

    Raises:
        OSError: if no process can be started.
    """
    with _LOCK:
        fork_server = _fork_server(os.getpid())
    try:
        return fork_server.start(arguments, given)
    except (OSError, EOFError):  # the fork server was killed: start another one, once
        with _LOCK:
            _fork_server.cache_clear()
            fork_server = _fork_server(os.getpid())
        return fork_server.start(arguments, given)


def main(descriptor: int) -> None:
    """Serve fork requests of the process at the other end of a socket, until it is gone."""
    for name in _PRELOADED:
        importlib.import_module(name)
    from xpl_cli.standard.validate import validate

    for name in _SCHEMAS:
        validate({}, name)
    gc.collect()
    gc.freeze()
    channel = socket.socket(fileno=descriptor)
    tool = Channel(channel)
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            request = tool.receive_head()
            if "status" in request:
                _, status = os.waitpid(request["status"], 0)
                answer = {"code": os.waitstatus_to_exitcode(status)}
            else:
                wants = _STREAMS + 1 + (request["given"] is not None)
                tool.send({"wants": wants})
                _, descriptors, _, _ = socket.recv_fds(channel, 1, wants)
                pid = os.fork()
                if pid == 0:
                    _run_child(channel, request, descriptors)
                for received in descriptors:
                    os.close(received)
                answer = {"pid": pid}
            tool.send(answer)


def _run_child(channel: socket.socket, request: Head, descriptors: Sequence[int]) -> NoReturn:
    """Run the command in this forked process."""
    channel.close()
    os.setsid()
    for number, received in enumerate(descriptors[:_STREAMS]):
        os.dup2(received, number)
        os.close(received)
    os.set_inheritable(descriptors[_STREAMS], False)  # noqa: FBT003 - positional only
    os.environ.clear()
    os.environ.update(request["environment"])
    if request["given"] is not None:
        os.environ[request["given"]] = str(descriptors[-1])
    os.chdir(request["cwd"])
    for number, limits in request["limits"]:
        with contextlib.suppress(OSError, ValueError):  # a hard limit above the current one
            resource.setrlimit(number, tuple(limits))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["xpl", *request["arguments"]]
    with contextlib.suppress(OSError):  # its command line is still the fork server's; `ps` and `top` show this
        Path("/proc/self/comm").write_text(" ".join(sys.argv[:2]), encoding="utf-8")
    _exit(_run())


def _run() -> int:
    """Run the command line of this process, and return its exit code."""
    try:
        runpy.run_module("xpl_cli", run_name="__main__")
    except SystemExit as ended:
        if ended.code is None or isinstance(ended.code, int):
            return ended.code or 0
        sys.stderr.write(f"{ended.code}\n")
        return 1
    except BaseException:  # noqa: BLE001 - as the interpreter does
        sys.excepthook(*sys.exc_info())
        return 1
    return 0


def _exit(code: int) -> NoReturn:
    """End as the interpreter does, but leave the memory to the system.

    Freeing inherited objects one by one would first copy their pages, which takes longer than a short command.
    """
    threading._shutdown()  # type: ignore[attr-defined]  # noqa: SLF001 - as `multiprocessing` ends what it forked
    atexit._run_exitfuncs()  # noqa: SLF001
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # the reader is gone
            stream.flush()
    os._exit(code)


def _is_readable(descriptor: int, timeout: float | None) -> bool:
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_READ)
        return bool(selector.select(timeout))
