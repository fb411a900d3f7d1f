"""Parent's side of an environment in a separate process: start, one message at a time, end.

The process leads its own process group and ends with its parent, however that ends (`xpl.process.child`).
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl.process import child, link
from xpl.process.parent import Process, ProcessLostError
from xpl.wire import packed

if TYPE_CHECKING:
    from xpl.wire.arrays import Data

_START = "from xpl.simulator.worker import main; main(int(sys.argv[2]))"
_GRACE_S = child.MAIN_THREAD_S + child.CLEANUP_S + 2.0
"""Time for a process to close its environment: its own limit, and a little more."""
_LOOK_S = 0.005


class EnvLostError(ProcessLostError):
    """The process ended, or did not answer in time and was killed."""


class EnvRaisedError(RuntimeError):
    """The environment raised.

    Args:
        kind: name of the exception's type.
        message: its text.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(f"{kind}: {message}")
        self.kind = kind
        self.message = message


def message(op: str, value: object) -> list[Data]:
    """Return the pieces of a message to a worker.

    Raises:
        PackingError: the value cannot be encoded.
    """
    return link.encode({"op": op}, [b"".join(packed.encode(value))])


class EnvProcess(Process):
    """One worker of an environment (`xpl.simulator.worker`), one message at a time.

    Args:
        python: interpreter; this one by default. It needs numpy and the environment's imports, not the SDK.
        prefix: put before the command, for an isolation.
        environment: variables of the process; those of this process by default.

    Attributes:
        pid: process id, and id of its process group.

    Raises:
        OSError: the interpreter does not exist.
    """

    name = "the environment"
    lost_error = EnvLostError

    def __init__(
        self, python: str | None = None, *, prefix: Sequence[str] = (), environment: Mapping[str, str] | None = None
    ) -> None:
        super().__init__(_START, python, prefix=prefix, environment=environment)

    def receive(self) -> Any:
        """Return the answer to the last message; its arrays are read-only.

        Raises:
            EnvRaisedError: the environment raised.
            EnvLostError: there is no answer.
        """
        head, buffers = self.take()
        if "error" in head:
            raise EnvRaisedError(head["error"]["type"], head["error"]["message"])
        return packed.decode(buffers[0])

    def kill(self) -> None:
        """Let the process close its environment and end; kill it if that takes too long.

        The process does so when the link is closed, also in the middle of a step.
        """
        self._channel.close()
        deadline = time.monotonic() + _GRACE_S
        with contextlib.suppress(ChildProcessError):  # it has been reaped already
            # WNOWAIT: until it is reaped, its id is not reused.
            while not os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                if time.monotonic() > deadline:
                    break
                time.sleep(_LOOK_S)
        super().kill()

    def close(self) -> None:
        """Close the environment and end the process; closing twice is fine."""
        self.kill()
