"""Worker process of an environment: makes it from its client file and runs its methods, in its own interpreter.

Standard library and numpy only, besides what the environment needs. Messages have a head, in JSON, and one packed value
(`xpl.process.link`, `xpl.wire.packed`):

    {"op": "make"}, {"client", "config"}         -> {"ok": true}, {"guarded", "methods"}
    {"op": "run"}, [[method, arguments], ...]    -> {"ok": true}, the result of each
    {"op": "close"}, null                        -> {"ok": true}, null

An exception is answered by `{"error": {"type", "message"}}`, and the calls after it are not run. Before the process
ends, except by SIGKILL, the environment is closed: an arm must not be left moving.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, NoReturn

from xpl import _spec as spec
from xpl.environment import NotInstalledError
from xpl.process import child
from xpl.process.modules import load_module
from xpl.simulator import terminal
from xpl.wire import error_text, packed

if TYPE_CHECKING:
    from xpl.wire.arrays import Data


MAKE, RUN, CLOSE = "make", "run", spec.Message.CLOSE


class EnvWorker:
    """Runs the operations of one environment."""

    def __init__(self) -> None:
        self._env: Any = None
        self._is_closed = False

    def handle(self, head: Mapping[str, Any], buffers: Sequence[Data]) -> tuple[dict[str, Any], list[Data]]:
        """Return the answer to one message; an exception of the environment becomes an `error`."""
        operations: dict[str, Callable[[Any], Any]] = {MAKE: self._make, RUN: self._run, CLOSE: self._close}
        try:
            result = operations[head["op"]](packed.decode(buffers[0]))
            return {"ok": True}, [b"".join(packed.encode(result))]
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a simulator may call sys.exit
            description = error_text.describe(error)
            if not isinstance(error, (ValueError, NotInstalledError)):  # the message suffices
                sys.stderr.write(description["traceback"])
            return {"error": {"type": description["type"], "message": description["message"]}}, []

    def _make(self, request: Mapping[str, Any]) -> dict[str, Any]:
        self._env = load_module(Path(request["client"])).make(request["config"])
        methods = [name for name in dir(self._env) if not name.startswith("_")]
        return {"guarded": bool(getattr(self._env, "guarded", False)), "methods": methods}

    def _run(self, calls: Sequence[Sequence[Any]]) -> list[Any]:
        return [getattr(self._env, method)(*arguments) for method, arguments in calls]

    def _close(self, _nothing: None) -> None:
        self._is_closed = True
        if self._env is not None:
            self._env.close()

    def leave(self) -> None:
        """Close the environment, unless it is closed."""
        if not self._is_closed:
            self._close(None)


def main(descriptor: int) -> NoReturn:
    """Answer the messages on a descriptor until it is closed."""
    terminal.use_terminal()
    worker = EnvWorker()
    child.serve(descriptor, worker.handle, worker.leave)
