"""An environment in a process of its own, seen from outside: start, one message at a time, end.

The process leads a group of its own and ends with whoever started it, however that ends (`xpl.process.child`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.process import link
from xpl.process.parent import Process, ProcessLostError
from xpl.wire import packed

if TYPE_CHECKING:
    from xpl.wire.arrays import Data

_START = "from xpl.simulator.worker import main; main(int(sys.argv[2]))"
_GRACE_S = 5.0


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


def message(op: str, value: Any) -> list[Data]:
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

    def close(self) -> None:
        """Let the environment close what it holds, as long as that takes no more than a few seconds, and end it."""
        with contextlib.suppress(EnvLostError, EnvRaisedError):
            self.send(message(spec.Message.CLOSE, None), _GRACE_S)
            self.receive()
        self.kill()
