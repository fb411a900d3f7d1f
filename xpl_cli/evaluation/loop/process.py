"""The process of an adapter's evaluation loop, from the side that judges it.

No code of an adapter runs where episodes are judged: its loop has a process of its own, with proxies of environment and
policy (`xpl.loop`). The environment stays here, and `request_handler` executes the loop's requests. The process
inherits one end of a private link, and neither a path nor a secret of the run.
"""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.loop.shared_arrays import SharedArrays
from xpl.process import link
from xpl.process.parent import Process, ProcessLostError
from xpl.wire.packed import PackingError
from xpl_cli.basics.errors import NotFoundError
from xpl_cli.evaluation.loop import messages
from xpl_cli.evaluation.loop.messages import LoopException, LoopProtocolError, LoopRequest
from xpl_cli.evaluation.loop.request_handler import LoopError, LoopRequestHandler
from xpl_cli.isolation import processes
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from pathlib import Path

    from xpl.environment import TaskEnv
    from xpl.wire.arrays import Data
    from xpl_cli.isolation.sandbox import Isolation

_START = "from xpl.loop.worker import main; main(int(sys.argv[2]))"
_MAX_MESSAGE_BYTES = 1 << 30
"""Bytes of a message from a loop: more than the observations of many environments are."""


@dataclass(frozen=True)
class LoopTimeouts:
    """How long a loop may take before it counts as hung.

    Attributes:
        load_s: to import deploy.py.
        request_s: between one operation of environment or policy and the next, and until it returns.
    """

    load_s: float = 300.0
    request_s: float = 60.0


class LoopLostError(LoopError):
    """The loop's process ended, hung or fell out of step: it has been ended."""


class LoopRaisedError(LoopError):
    """The loop, or deploy.py when it was imported, raised.

    Attributes:
        kind: type of the exception.
        message: its text.
    """

    def __init__(self, raised: LoopException) -> None:
        super().__init__(f"the adapter's evaluation loop raised {raised.kind}: {raised.message}")
        self.kind = raised.kind
        self.message = raised.message


class _Process(Process):
    name = "the evaluation loop"

    def kill(self) -> None:
        """End the process, its group, and what has left the group and is still its child."""
        below = processes.descendants(self.pid)
        super().kill()
        for member in below:
            if member.is_alive:
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.kill(member.pid, 9)


class AdapterLoop:
    """The evaluation loops of an adapter, in a process that is started on demand and restarted when it was lost.

    Args:
        adapter: folder of the adapter.
        limits: timeouts.
        isolation: of the process, or None.
        is_silent: whether to discard what it prints.

    Raises:
        NotFoundError: the adapter has no deploy.py.
    """

    def __init__(
        self,
        adapter: Path,
        *,
        limits: LoopTimeouts | None = None,
        isolation: Isolation | None = None,
        is_silent: bool = False,
    ) -> None:
        self._file = adapter / sdk.File.DEPLOY_PY
        if not self._file.is_file():
            raise NotFoundError(f"{adapter} has no {sdk.File.DEPLOY_PY}")
        self._limits = limits or LoopTimeouts()
        self._isolation = isolation
        self._is_silent = is_silent
        self._process: _Process | None = None
        self._shared_arrays = SharedArrays()
        self._functions: frozenset[str] = frozenset()

    def load(self, *, batch: bool) -> str:
        """Import deploy.py once, and return the name of its loop.

        Args:
            batch: whether to use the loop for several environments.

        Raises:
            NotFoundError: it has no such loop.
            LoopRaisedError: it raised when it was imported.
            LoopLostError: its process ended, or hung.
        """
        if self._process is None:
            self._start()
        single, batched = spec.data("package")["loop"]["functions"]
        name: str = batched if batch else single
        if name not in self._functions:
            raise NotFoundError(f"{self._file} has no function {name}")
        return name

    def run_trial(self, task_env: TaskEnv, client: Any, *, batch: bool) -> None:
        """Let the loop run a trial.

        Args:
            task_env: the environment, reset.
            client: `call(func_name=..., obs=...)` runs an operation of the policy.
            batch: whether to use the loop for several environments.

        Raises:
            NotFoundError, LoopRaisedError, LoopLostError: as for `load`, or during the trial.
            EndlessLoopError: it does not end.
            ActionError, ClientError, ValueError, TypeError: environment or policy refused a request, which ended the
                loop.
            EnvLostError, EnvRaisedError, ClientError: environment or policy failed.
        """
        name = self.load(batch=batch)
        handler = LoopRequestHandler(task_env, client, self._shared_arrays)
        try:
            raised = self._answer_requests(handler, name)
        except BaseException:
            self.close()  # in the middle of a trial: it could not go on with the next one
            raise
        if handler.rejected is not None and (handler.is_unreported or (raised is not None and raised.is_reported)):
            raise handler.rejected
        if raised is not None:
            raise LoopRaisedError(raised)

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()

    def _answer_requests(self, handler: LoopRequestHandler, name: str) -> LoopException | None:
        """Answer the requests of a loop until it ends; return its exception, or None."""
        assert self._process is not None  # noqa: S101 - for the type checker: it was loaded
        pieces: list[Data] | None = link.encode({"run": name, "running": handler.running})
        try:
            while True:
                self._process.send(pieces or (), self._limits.request_s)
                message = messages.parse_message(*self._process.take(), self._shared_arrays)
                if not isinstance(message, LoopRequest):
                    return message
                pieces = handler.answer(message)
        except (ProcessLostError, LoopProtocolError, PackingError) as error:
            raise LoopLostError(str(error)) from None

    def _start(self) -> None:
        isolation = self._isolation
        self._process = _Process(
            _START,
            prefix=() if isolation is None else isolation.prefix,
            environment=None if isolation is None else isolation.environment(os.environ),
            is_silent=self._is_silent,
            largest=_MAX_MESSAGE_BYTES,
        )
        self._shared_arrays = SharedArrays()
        try:
            self._process.send(link.encode({"load": str(self._file)}), self._limits.load_s)
            head, _ = self._process.take()
        except ProcessLostError as error:
            self.close()
            raise LoopLostError(f"{sdk.File.DEPLOY_PY} cannot be imported: {error}") from None
        except BaseException:
            self.close()
            raise
        functions = messages.parse_functions(head)
        if isinstance(functions, LoopException):
            self.close()
            raise LoopRaisedError(functions)
        self._functions = functions
