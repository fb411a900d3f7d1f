"""Worker processes of one environment package: started and called together, lost one by one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl.action import ActionError
from xpl.simulator.process import EnvLostError, EnvProcess, EnvRaisedError, message

if TYPE_CHECKING:
    from xpl.contract import Config

Calls = Sequence[Sequence[Any]]
"""Method calls in order: (method, arguments)."""


@dataclass(frozen=True)
class EnvTimeouts:
    """Time limits after which a worker counts as hung.

    Attributes:
        step_s: of a step, or an observation, of all its environments, s.
        start_s: of making the environments, and of reset, s.
    """

    step_s: float = 60.0
    start_s: float = 300.0


class EnvWorkerPool:
    """Workers that run environments of one package.

    Args:
        client: the package's client file, which defines `make(config)`.
        configs: configuration of each worker.
        python: interpreter of all; this one by default.
        limits: time limits.

    Attributes:
        limits: time limits.
        lost: for each worker, why it was lost; "" while it runs.
        methods: public methods of the environment.
        guarded: whether the environment enforces its robot's limits itself.

    Raises:
        ValueError: the environment refuses a configuration.
        EnvRaisedError: it raised another error.
        EnvLostError: a process ended, or did not answer.
    """

    def __init__(
        self,
        client: Path,
        configs: Sequence[Config],
        python: str | None = None,
        limits: EnvTimeouts | None = None,
    ) -> None:
        self._client, self._configs, self._python = str(client), configs, python
        self.limits = limits or EnvTimeouts()
        self._processes: list[EnvProcess | None] = [None for _ in configs]
        self.lost = ["" for _ in configs]
        self.methods: frozenset[str] = frozenset()
        self.guarded = False
        try:
            self._start_all()
        except BaseException:
            self.close()
            raise

    @property
    def pids(self) -> list[int]:
        """Process ids of the running workers."""
        return [process.pid for process in self._processes if process is not None]

    def start_missing(self) -> None:
        """Restart all lost workers at once; one that is lost again stays lost.

        Raises:
            ValueError, EnvRaisedError: see the constructor.
        """
        missing = [worker for worker, process in enumerate(self._processes) if process is None]
        for worker in missing:
            self._processes[worker], self.lost[worker] = EnvProcess(self._python), ""
        requests = {worker: {"client": self._client, "config": dict(self._configs[worker])} for worker in missing}
        answers, raised = self._exchange("make", requests, self.limits.start_s)
        _raise_first(raised.values())
        for answer in answers.values():
            self.guarded, self.methods = answer["guarded"], frozenset(answer["methods"])

    def reset(self, calls: Mapping[int, Calls]) -> dict[int, list[Any]]:
        """Run calls that begin an episode; return the results of each running worker.

        Args:
            calls: by worker, pairs (method, arguments).

        Raises:
            ValueError: an environment refuses an argument.
            EnvRaisedError: it raised something else.
        """
        return self._run_or_raise(calls, self.limits.start_s)

    def query(self, calls: Mapping[int, Calls]) -> dict[int, list[Any]]:
        """Run calls that change nothing; a worker whose environment raises is kept.

        Raises:
            ValueError: an environment refuses an argument.
            EnvRaisedError: it raised something else.
        """
        return self._run_or_raise(calls, self.limits.step_s)

    def run(self, calls: Mapping[int, Calls]) -> dict[int, list[Any]]:
        """Run calls of an episode; a worker whose environment raises is lost, unless it raises ActionError.

        Raises:
            ActionError: an environment refuses an action.
        """
        answers, raised = self._exchange("run", calls, self.limits.step_s)
        refused = {worker for worker, error in raised.items() if error.kind == ActionError.__name__}
        for worker in raised.keys() - refused:
            self._mark_lost(worker, f"the environment raised {raised[worker]}")
        _raise_first(raised[worker] for worker in refused)
        return answers

    def close(self) -> None:
        """Close the environments and end the processes."""
        for worker, process in enumerate(self._processes):
            if process is not None:
                process.close()
            self._processes[worker] = None

    def _run_or_raise(self, calls: Mapping[int, Calls], limit_s: float) -> dict[int, list[Any]]:
        """Run calls; raise the error of an environment, whose worker is kept."""
        answers, raised = self._exchange("run", calls, limit_s)
        _raise_first(raised.values())
        return answers

    def _start_all(self) -> None:
        self.start_missing()
        if any(self.lost):
            raise EnvLostError(next(filter(None, self.lost)))

    def _exchange(
        self, op: str, requests: Mapping[int, object], limit_s: float
    ) -> tuple[dict[int, Any], dict[int, EnvRaisedError]]:
        """Send to all running workers, then wait for all; return their answers, and the errors of environments."""
        # Encode all before the first is sent: one that cannot be encoded leaves no worker out of step.
        messages = {worker: message(op, value) for worker, value in requests.items()}
        sent: dict[int, EnvProcess] = {}
        for worker, pieces in messages.items():
            process = self._processes[worker]
            if process is not None:
                try:
                    process.send(pieces, limit_s)
                    sent[worker] = process
                except EnvLostError as error:
                    self._mark_lost(worker, str(error))
        answers: dict[int, Any] = {}
        raised: dict[int, EnvRaisedError] = {}
        for worker, process in sent.items():
            try:
                answers[worker] = process.receive()
            except EnvRaisedError as error:  # noqa: PERF203 - the other workers' answers are still received
                raised[worker] = error
            except EnvLostError as error:
                self._mark_lost(worker, str(error))
        return answers, raised

    def _mark_lost(self, worker: int, reason: str) -> None:
        process, self._processes[worker] = self._processes[worker], None
        if process is not None:
            process.kill()
        self.lost[worker] = reason


def _raise_first(raised: Iterable[EnvRaisedError]) -> None:
    """Raise the first error of the environments; as ActionError or ValueError if it was one."""
    for error in raised:
        error_type = {ActionError.__name__: ActionError, ValueError.__name__: ValueError}.get(error.kind)
        raise error if error_type is None else error_type(error.message) from None
