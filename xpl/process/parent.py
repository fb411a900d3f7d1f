"""Parent's side of a child process: one message at a time, each with a deadline, and a guaranteed end.

The process leads its own process group and ends with its parent, however that ends (`xpl.process.child`).
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
from xpl.wire.process_frame import BODY_LIMIT, PackingError

if TYPE_CHECKING:
    from xpl.wire.arrays import Data

_LOOK_S = 0.5
"""Interval at which a silent process is polled, s: its children may keep the link open after it has ended."""
_GRACE_S = 5.0


class ProcessLostError(RuntimeError):
    """The process ended, did not answer in time, or sent a malformed message; it has been killed."""


class Process:
    """A child process that answers one message at a time.

    Args:
        start: code that it runs after `child.SDK_START`; its second argument is the number of its end of the link.
        python: interpreter; this one by default. It needs numpy, not the SDK.
        prefix: put before the command, for an isolation.
        environment: variables of the process; those of this process by default.
        is_silent: discard its output.
        largest: most bytes of a message that it sends.

    Attributes:
        pid: process id, and id of its process group.

    Raises:
        OSError: the interpreter does not exist.
    """

    name = "the process"
    """Name of the process in messages."""
    lost_error: type[ProcessLostError] = ProcessLostError
    """Exception that is raised when the process is lost."""

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
        self._output = threading.Thread(target=_forward_output, args=(self._process.stdout,), daemon=True)
        self._output.start()
        self._is_launched = bool(prefix)
        self._inbox = link.Inbox(largest)
        self._ready: list[Data] = []
        self._limit_s = self._deadline = 0.0
        self._is_killed = False

    def send(self, pieces: Sequence[Data], limit_s: float) -> None:
        """Send a message; `take` returns the answer.

        Args:
            pieces: of the message (`link.encode`).
            limit_s: seconds within which the answer must arrive.

        Raises:
            ProcessLostError: the process is gone, or does not read.
        """
        self._limit_s, self._deadline = limit_s, time.monotonic() + limit_s
        try:
            self._channel.settimeout(limit_s)
            for piece in link.coalesce(pieces):
                self._channel.sendall(piece)
        except socket.timeout:
            raise self._kill_and_report(self._timeout_message()) from None
        except OSError:
            raise self._kill_and_report(self._exit_message()) from None

    def take(self) -> tuple[Any, list[memoryview]]:
        """Return head and buffers of the next message of the process; the buffers are read-only.

        Raises:
            ProcessLostError: no message in time, or a malformed one.
        """
        while not self._ready:
            left = self._deadline - time.monotonic()
            if left <= 0:
                raise self._kill_and_report(self._timeout_message())
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
                raise self._link_error(error) from None
            if not count:
                raise self._kill_and_report(self._exit_message())
        try:
            return link.decode(self._ready.pop(0))
        except PackingError as error:
            raise self._link_error(error) from None

    def kill(self) -> None:
        """Kill the process and its children; killing twice is fine."""
        if self._is_killed:  # its id may have been reused
            return
        self._is_killed = True
        self._channel.close()
        spawn.end_group(self.pid)
        self._process.wait()
        self._output.join(_LOOK_S)  # a child that left the group may keep the pipe open

    def _timeout_message(self) -> str:
        return f"{self.name} did not answer within {self._limit_s:g} s"

    def _exit_message(self) -> str:
        """Return how the process ended."""
        try:
            code = self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            return f"{self.name}'s process closed its link"
        return f"{self.name}'s process {spawn.describe_exit(code, launched=self._is_launched)}"

    def _link_error(self, error: Exception) -> ProcessLostError:
        return self._kill_and_report(f"the link to {self.name} broke: {error}")

    def _kill_and_report(self, reason: str) -> ProcessLostError:
        self.kill()
        return self.lost_error(reason)


def _forward_output(output: IO[bytes] | None) -> None:
    """Copy the output of a process to standard error, which the process must not inherit.

    A process that has a terminal open can read from it and set it, and can truncate a log file.
    """
    if output is None:
        return
    text = codecs.getincrementaldecoder("utf-8")(errors="replace")
    with output, contextlib.suppress(OSError, ValueError):
        while chunk := output.read1(1 << 15):  # type: ignore[attr-defined]
            sys.stderr.write(text.decode(chunk))
            sys.stderr.flush()
