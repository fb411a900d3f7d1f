"""An environment in a process of its own, seen from outside: start, one message at a time, end.

The process leads a group of its own and ends with whoever started it, however that ends (`xpl.process.child`).
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
_GRACE_S = child.TURN_S + child.LEAVE_S + 2.0
"""What a process is given to close its environment: the time that it gives itself, and a little more."""
_LOOK_S = 0.005


class EnvLostError(ProcessLostError):
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


def message(op: str, value: object) -> list[Data]:
    """Return the pieces of a message to a worker.

    Raises:
        PackingError: the value holds what cannot travel.
    """
    return link.encode({"op": op}, [b"".join(packed.encode(value))])


class EnvProcess(Process):
    """One worker of an environment (`xpl.simulator.worker`), asked one message at a time.

    Args:
        python: interpreter; this one by default. It needs numpy and what the environment imports, and not the SDK.
        prefix: what is put before the command, to keep it within bounds.
        environment: variables of the process; ours by default.

    Attributes:
        pid: the process, which leads a group of its own.

    Raises:
        OSError: there is no such interpreter.
    """

    name = "the environment"
    lost_error = EnvLostError

    def __init__(
        self, python: str | None = None, *, prefix: Sequence[str] = (), environment: Mapping[str, str] | None = None
    ) -> None:
        super().__init__(_START, python, prefix=prefix, environment=environment)

    def receive(self) -> Any:
        """Return the answer to what was sent; its arrays are read-only.

        Raises:
            EnvRaisedError: the environment raised.
            EnvLostError: there is no answer.
        """
        head, buffers = self.take()
        if "error" in head:
            raise EnvRaisedError(head["error"]["type"], head["error"]["message"])
        return packed.decode(buffers[0])

    def kill(self) -> None:
        """End the process, once it has closed its environment; at once where that takes too long.

        It does so by itself when the link is closed, also in the middle of a step.
        """
        self._channel.close()
        deadline = time.monotonic() + _GRACE_S
        with contextlib.suppress(ChildProcessError):  # it has been waited for already
            # Left to be waited for: until then its number is its own.
            while not os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                if time.monotonic() > deadline:
                    break
                time.sleep(_LOOK_S)
        super().kill()

    def close(self) -> None:
        """Close the environment and end the process; closing twice is fine."""
        self.kill()
