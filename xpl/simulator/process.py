"""An environment in a process of its own, seen from outside: start, one message at a time, end.

The process leads a group of its own and ends with whoever started it, however that ends (`xpl.process.child`).
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.process import child, link
from xpl.wire import packed

if TYPE_CHECKING:
    from xpl.wire.arrays import Data

_START = child.SDK_START + "from xpl.simulator.worker import main; main(int(sys.argv[2]))"
_BUFFER = 1 << 22
_LOOK_S = 0.5
"""How often a silent process is looked at: its children may hold the link open after it has ended."""
_GRACE_S = 5.0


class EnvLostError(RuntimeError):
    """The process ended, or did not answer in time; it has been ended then."""


class EnvRaisedError(RuntimeError):
    """The environment raised.

    Args:
        kind: type of what it raised.
        message: what that says.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(f"{kind}: {message}")
        self.kind = kind
        self.message = message


def message(op: str, value: Any) -> list[Data]:
    """Return the pieces of a message to a worker.

    Raises:
        PackingError: the value holds what cannot travel.
    """
    return link.encode({"op": op}, [b"".join(packed.encode(value))])


class EnvProcess:
    """One worker of an environment (`xpl.simulator.worker`), asked one message at a time.

    Args:
        python: interpreter; this one by default. It needs numpy and what the environment imports, and not the SDK.

    Attributes:
        pid: the process, which leads a group of its own.

    Raises:
        OSError: there is no such interpreter.
    """

    def __init__(self, python: str | None = None) -> None:
        self._channel, theirs = socket.socketpair()
        for end in (self._channel, theirs):
            for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                end.setsockopt(socket.SOL_SOCKET, option, _BUFFER)
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        # Our own path settings must not leak into another interpreter.
        environment.pop("PYTHONHOME", None)
        sdk = str(Path(child.__file__).parents[1])
        with theirs:
            try:
                self._process = subprocess.Popen(
                    [python or sys.executable, "-c", _START, sdk, str(theirs.fileno())],
                    stdin=subprocess.DEVNULL,
                    pass_fds=[theirs.fileno()],
                    env=environment,
                    start_new_session=True,
                )
            except OSError:
                self._channel.close()
                raise
        self.pid = self._process.pid
        self._inbox = link.Inbox()
        self._ready: list[Data] = []
        self._limit_s = self._deadline = 0.0

    def send(self, pieces: Iterable[Data], limit_s: float) -> None:
        """Send a message, whose answer `receive` returns.

        Args:
            pieces: of the message (`message`).
            limit_s: seconds until the answer has to be there.

        Raises:
            EnvLostError: the process is gone, or took in nothing.
        """
        self._limit_s, self._deadline = limit_s, time.monotonic() + limit_s
        try:
            self._channel.settimeout(limit_s)
            for piece in pieces:
                self._channel.sendall(piece)
        except socket.timeout:
            raise self._lost(self._late()) from None
        except OSError:
            raise self._lost(self._ended()) from None

    def receive(self) -> Any:
        """Return the answer to what was sent; its arrays are read-only.

        Raises:
            EnvRaisedError: the environment raised.
            EnvLostError: there is no answer.
        """
        while not self._ready:
            left = self._deadline - time.monotonic()
            if left <= 0:
                raise self._lost(self._late())
            self._channel.settimeout(min(left, _LOOK_S))
            try:
                count = self._channel.recv_into(self._inbox.space())
                self._ready = self._inbox.take(count) if count else []
            except socket.timeout:
                if self._process.poll() is None:
                    continue
                count = 0
            except OSError:
                count = 0
            except link.LinkError as error:
                raise self._lost(f"the link to the environment broke: {error}") from None
            if not count:
                raise self._lost(self._ended())
        head, buffers = link.decode(self._ready.pop(0))
        if "error" in head:
            raise EnvRaisedError(head["error"]["type"], head["error"]["message"])
        return packed.decode(buffers[0])

    def kill(self) -> None:
        """End the process and its children at once; killing twice is fine."""
        self._channel.close()
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)
        self._process.wait()

    def close(self) -> None:
        """Let the environment close what it holds, as long as that takes no more than a few seconds, and end it."""
        with contextlib.suppress(EnvLostError, EnvRaisedError):
            self.send(message(spec.Message.CLOSE, None), _GRACE_S)
            self.receive()
        self.kill()

    def _late(self) -> str:
        return f"the environment did not answer within {self._limit_s:g} s"

    def _ended(self) -> str:
        """Return how the process ended."""
        try:
            code = self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            return "the environment's process closed its link"
        if code >= 0:
            return f"the environment's process ended with exit code {code}"
        names = {number.value: number.name for number in signal.Signals}
        return f"the environment's process was ended by signal {names.get(-code, -code)}"

    def _lost(self, reason: str) -> EnvLostError:
        self.kill()
        return EnvLostError(reason)
