"""A plain client of the wire, the command line, and ways to wait for what processes do."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import time
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.support import forked
from xpl.wire import codec

DEADLINE_S = 100.0
"""What any test waits for one thing before it gives up; tests/conftest.py makes it longer where all tests run."""
MARK = "XPL_TEST_SERVER"


def wait_until(condition: Callable[[], Any], what: str) -> Any:
    """Wait until a condition holds and return its value; fails after a deadline."""
    deadline = time.monotonic() + DEADLINE_S
    while not (value := condition()):
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.01)
    return value


def processes(mark: str) -> dict[int, str]:
    """Return the living processes that inherited a mark, with their command lines."""
    pattern = f"{MARK}={mark}".encode()
    pids = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if pattern in (entry / "environ").read_bytes().split(b"\0"):
                pids[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    return pids


def xpl(*args: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run the command line."""
    return forked.run(*args, cwd=cwd)


class Peer:
    """A client that speaks frames and hides nothing: what `xpl.Client` would repair stays visible."""

    def __init__(self, url: str, evaluation_id: str | None = None) -> None:
        self.evaluation_id = evaluation_id or uuid.uuid4().hex
        self._open = contextlib.ExitStack()
        self.socket = self._open.enter_context(connect(url, compression=None, max_size=None, proxy=None))

    def send(self, message_type: str, payload: Mapping[str, Any] | None = None, **fields: Any) -> codec.Frame:
        """Send a request and return it."""
        frame = codec.Frame(message_type, self.evaluation_id, dict(payload or {}), **fields)
        self.socket.send(codec.encode(frame))
        return frame

    def receive(self) -> codec.Frame:
        """Return the next frame."""
        data = self.socket.recv(timeout=DEADLINE_S)
        assert isinstance(data, bytes)
        return codec.decode(data)

    def ask(self, message_type: str, payload: Mapping[str, Any] | None = None, **fields: Any) -> codec.Frame:
        """Send a request and return its answer."""
        request = self.send(message_type, payload, **fields)
        while (answer := self.receive()).message_id != request.message_id:
            pass
        return answer

    def cut(self) -> None:
        """Lose the connection without a word of the protocol."""
        self.socket.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the connection in order."""
        self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Say goodbye, if anybody still listens, and close."""
        with contextlib.suppress(ConnectionClosed):
            self.send("close")
        self.close()


def greeted(url: str, evaluation_id: str | None = None, **capabilities: Any) -> Peer:
    """Return a client that has a place at a server, once there is one."""
    peer = Peer(url, evaluation_id)
    hello = {"capabilities": capabilities}
    wait_until(lambda: peer.ask("hello", hello).message_type == "hello_ack", "the server has a place")
    return peer
