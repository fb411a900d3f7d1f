"""A process of our own, seen from whoever started it: one message at a time, each with a deadline, and a certain end.

The process leads a group of its own and ends with whoever started it, however that ends (`xpl.process.child`).
"""

from __future__ import annotations

import codecs
import contextlib
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from typing import IO, TYPE_CHECKING, Any

from xpl.process import child, link, spawn
from xpl.wire.frame import BODY_LIMIT, PackingError

if TYPE_CHECKING:
    from xpl.wire.arrays import Data

_LOOK_S = 0.5
"""How often a silent process is looked at: its children may hold the link open after it has ended."""
_GRACE_S = 5.0


class ProcessLostError(RuntimeError):
    """The process ended, did not answer in time, or sent what is no message; it has been ended then."""


class Process:
    """A child process of ours, asked one message at a time.

    Args:
        start: code that it runs after `child.SDK_START`; its second argument is the number of its end of the link.
        python: interpreter; this one by default. It needs numpy, and not the SDK.
        prefix: what is put before the command, as an isolation has it.
        environment: variables of the process; ours by default.
        is_silent: whether what it prints is thrown away.
        largest: most bytes of a message from it.

    Attributes:
        pid: the process, which leads a group of its own.

    Raises:
        OSError: there is no such interpreter.
    """

    name = "the process"
    """What it is called in sentences."""
    lost_error: type[ProcessLostError] = ProcessLostError
    """What is raised when it is lost."""

    def __init__(  # noqa: PLR0913 - keywords, and how one process differs from another
        self,
        start: str,
        python: str | None = None,
        *,
        prefix: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
        is_silent: bool = False,
        largest: int = BODY_LIMIT,
    ) -> None:
        self._channel, theirs = spawn.link()
        with theirs:
            try:
                self._process = subprocess.Popen(
                    spawn.command(
                        python or sys.executable, child.SDK_START + start, str(theirs.fileno()), prefix=prefix
                    ),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL if is_silent else subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    pass_fds=[theirs.fileno()],
                    env=spawn.variables(environment),
                    start_new_session=True,
                )
            except OSError:
                self._channel.close()
                raise
        self.pid = self._process.pid
        self._output = threading.Thread(target=_show, args=(self._process.stdout,), daemon=True)
        self._output.start()
        self._is_launched = bool(prefix)
        self._inbox = link.Inbox(largest)
        self._ready: list[Data] = []
        self._limit_s = self._deadline = 0.0
        self._is_killed = False

    def send(self, pieces: Sequence[Data], limit_s: float) -> None:
        """Send a message, whose answer `take` returns.

        Args:
            pieces: of the message (`link.encode`).
            limit_s: seconds until the answer has to be there.

        Raises:
            ProcessLostError: the process is gone, or took in nothing.
        """
        self._limit_s, self._deadline = limit_s, time.monotonic() + limit_s
        try:
            self._channel.settimeout(limit_s)
            for piece in link.joined(pieces):
                self._channel.sendall(piece)
        except socket.timeout:
            raise self._lost(self._late()) from None
        except OSError:
            raise self._lost(self._ended()) from None

    def take(self) -> tuple[Any, list[memoryview]]:
        """Return head and buffers of the next message of the process, which are read-only.

        Raises:
            ProcessLostError: there is none.
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
            except PackingError as error:
                raise self._broken(error) from None
            if not count:
                raise self._lost(self._ended())
        try:
            return link.decode(self._ready.pop(0))
        except PackingError as error:
            raise self._broken(error) from None

    def kill(self) -> None:
        """End the process and its children at once; killing twice is fine."""
        if self._is_killed:  # its number may be another's by now
            return
        self._is_killed = True
        self._channel.close()
        spawn.end_group(self.pid)
        self._process.wait()
        self._output.join(_LOOK_S)  # of one that left the group, the pipe may stay open

    def _late(self) -> str:
        return f"{self.name} did not answer within {self._limit_s:g} s"

    def _ended(self) -> str:
        """Return how the process ended."""
        try:
            code = self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            return f"{self.name}'s process closed its link"
        return f"{self.name}'s process {spawn.how_it_ended(code, launched=self._is_launched)}"

    def _broken(self, error: Exception) -> ProcessLostError:
        return self._lost(f"the link to {self.name} broke: {error}")

    def _lost(self, reason: str) -> ProcessLostError:
        self.kill()
        return self.lost_error(reason)


def _show(output: IO[bytes] | None) -> None:
    """Copy what a process prints to standard error, which it must not hold itself.

    A terminal can be read from and set by whoever has it open, and a log file be opened again and emptied.
    """
    if output is None:
        return
    text = codecs.getincrementaldecoder("utf-8")(errors="replace")
    with output, contextlib.suppress(OSError, ValueError):
        while chunk := output.read1(1 << 15):  # type: ignore[attr-defined]
            sys.stderr.write(text.decode(chunk))
            sys.stderr.flush()
