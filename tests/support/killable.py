"""A server that is killed and started again on its port, and what may not be left of anything afterwards."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import IO, Self

from tests.support.peer import DEADLINE_S, MARK, processes, wait_until

LISTENING, CONNECTED = "0A", "01"
"""States in /proc/net/tcp."""
SHM = Path("/dev/shm")  # noqa: S108 - looked at, not written to
SEGMENTS = "xpl-*"


class Server:
    """`xpl serve` on a port that it chooses, and keeps when it is started again; use it as a context.

    Attributes:
        port: where it listens; 0 before it was ready for the first time.
        pid: process of the front end.
        starts: how often it was started.
    """

    def __init__(self, adapter: Path, *options: str) -> None:
        self.port = 0
        self._command = [sys.executable, "-m", "xpl_cli", "serve", str(adapter)]
        # A place waits as long for a client that was cut as a connection does to be closed.
        self._command += ["--host", "127.0.0.1", "--set", "close_timeout_s=1", *options]
        self.mark = uuid.uuid4().hex
        self.starts = 0
        self._since = time.time()
        self.log: list[str] = []
        self._listens = False
        self._process: subprocess.Popen[bytes] | None = None
        self._stopping = False
        self._keeper: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Where clients connect without a proxy."""
        return f"ws://127.0.0.1:{self.port}"

    @property
    def pid(self) -> int:
        """Process of the front end."""
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        """Start it and wait until it is ready."""
        self._process = subprocess.Popen(
            [*self._command, "--port", str(self.port)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**os.environ, MARK: self.mark},
        )
        assert self._process.stdout is not None
        self.starts += 1
        self._listens = False
        ready = threading.Event()
        threading.Thread(target=self._read, args=(self._process.stdout, ready), daemon=True).start()
        assert ready.wait(DEADLINE_S), self.log
        assert self._listens or self._stopping or self._keeper, self.log

    def workers(self) -> list[int]:
        """Return the processes of its workers."""
        return [pid for pid, command in processes(self.mark).items() if "xpl.worker.main" in command]

    def kill(self, kind: str) -> None:
        """End a process by SIGKILL: all workers, or the front end."""
        for pid in self.workers() if kind == "kill_worker" else [self.pid]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def ended(self) -> bool:
        """Tell whether the front end has ended."""
        return self._process is not None and self._process.poll() is not None

    def keep_alive(self) -> None:
        """Start it again, from now on, whenever it has ended."""

        def keep() -> None:
            while not self._stopping:
                assert self._process is not None
                self._process.wait()
                if not self._stopping:
                    self.start()

        self._keeper = threading.Thread(target=keep)
        self._keeper.start()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping = True
        assert self._process is not None
        self._process.terminate()
        if self._keeper is not None:
            self._keeper.join()
        self._process.terminate()
        self._process.wait(DEADLINE_S)
        gone(lambda: processes(self.mark).values(), "processes of the server")
        gone(lambda: sockets(self.port, LISTENING, CONNECTED), "sockets of the server")
        gone(lambda: orphans(self._since), "shared memory")

    def _read(self, stream: IO[bytes], ready: threading.Event) -> None:
        """Collect what it prints; end of output counts as ready, so that nobody waits for a server that died."""
        with stream:
            for line in stream:
                self.log.append(line.decode(errors="replace").rstrip())
                if line.startswith(b'{"event": "ready"'):
                    self._listens = True
                    self.port = json.loads(line)["port"]
                    ready.set()
        ready.set()


# -- what must not be left ---------------------------------------------------------------------------------------------


def descriptors(pid: int) -> list[str]:
    """Return what the open file descriptors of a process are, without the numbers of sockets and pipes."""
    paths = []
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):  # the descriptor that lists the folder is gone again
            paths.append(re.sub(r"\[\d+\]", "", str(entry.readlink())))
    return paths


def sockets(port: int, *states: str) -> list[str]:
    """Return the TCP sockets of this port, on either side, that are in one of these states."""
    inodes = f"{port:04X}"
    addresses = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
            _, local, remote, state, *_ = line.split()
            if state in states and inodes in (local[-4:], remote[-4:]):
                addresses.append(f"{local} {remote} {state}")
    return addresses


def orphans(since: float) -> list[str]:
    """Return the segments of shared memory made since a moment that no living process has mapped or open.

    Others on this machine may be serving too: theirs are in use.
    """
    fresh = set()
    for path in SHM.glob(SEGMENTS):
        with contextlib.suppress(OSError):
            if path.stat().st_ctime >= since:
                fresh.add(str(path))
    for process in Path("/proc").glob("[0-9]*"):
        if not fresh:
            break
        with contextlib.suppress(OSError):
            maps = (process / "maps").read_text(encoding="utf-8", errors="replace")
            fresh -= {path for path in fresh if path in maps}
        with contextlib.suppress(OSError):
            fresh -= set(descriptors(int(process.name)))
    return sorted(fresh)


def listens(pid: int) -> int | None:
    """Return the TCP port on which a process listens, None before it does."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            inodes.add(entry.readlink().name)
    for line in Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]:
        columns = line.split()
        if columns[3] == LISTENING and f"socket:[{columns[9]}]" in inodes:
            return int(columns[1].rpartition(":")[2], 16)
    return None


@contextlib.contextmanager
def nothing_left(server: Server) -> Iterator[None]:
    """Check that a block leaves no descriptor here or in a server that lives on, no connection to it, no segment."""
    since = time.time()
    pids = {"this process": os.getpid(), "front end": server.pid, "worker": server.workers()[0]}
    before = {pid: Counter(descriptors(pid)) for pid in pids.values()}
    yield
    gone(lambda: sockets(server.port, CONNECTED), f"connections to port {server.port}")
    for name, pid in pids.items():
        gone(partial(_more, pid, before[pid]), f"descriptors of the {name}")
    gone(lambda: orphans(since), "shared memory")


def _more(pid: int, before: Counter[str]) -> list[str]:
    return [*(Counter(descriptors(pid)) - before).elements()]


def gone(left: Callable[[], Iterable[str]], what: str) -> None:
    """Wait until nothing is left, or tell what is."""
    try:
        wait_until(lambda: not left(), "nothing is left")
    except AssertionError:
        raise AssertionError(f"{what} left: {left()}") from None
