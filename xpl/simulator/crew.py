"""The worker processes of one environment package: started together, asked all at once, lost one by one."""

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
"""Operations in their order: a method, and its arguments."""


@dataclass(frozen=True)
class Limits:
    """How long a worker may take before it counts as hung.

    Attributes:
        step_s: for a step, or an observation, of all its environments.
        start_s: for making them, and for reset.
    """

    step_s: float = 60.0
    start_s: float = 300.0


class Crew:
    """Workers that play environments of one package.

    Args:
        client: the package's client file, which defines `make(config)`.
        configs: configuration of each worker.
        python: interpreter of all; this one by default.
        limits: how long they may take.

    Attributes:
        limits: the same.
        lost: for each worker, why it is lost; "" while it lives.
        methods: what the environment offers.
        guarded: whether it keeps its robot's limits itself.

    Raises:
        ValueError: the environment refuses a configuration.
        EnvRaisedError: it raised something else.
        EnvLostError: a process ended, or did not answer.
    """

    def __init__(
        self,
        client: Path,
        configs: Sequence[Config],
        python: str | None = None,
        limits: Limits | None = None,
    ) -> None:
        self._client, self._configs, self._python = str(client), configs, python
        self.limits = limits or Limits()
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
        """Process ids of the workers that live."""
        return [process.pid for process in self._processes if process is not None]

    def start_missing(self) -> None:
        """Start those that were lost, all at once; one that is lost again in the making stays so.

        Raises:
            ValueError, EnvRaisedError: as for the first time.
        """
        missing = [worker for worker, process in enumerate(self._processes) if process is None]
        for worker in missing:
            self._processes[worker], self.lost[worker] = EnvProcess(self._python), ""
        asked = {worker: {"client": self._client, "config": dict(self._configs[worker])} for worker in missing}
        answers, raised = self._ask("make", asked, self.limits.start_s)
        _raise_first(raised.values())
        for told in answers.values():
            self.guarded, self.methods = told["guarded"], frozenset(told["methods"])

    def reset(self, asked: Mapping[int, Calls]) -> dict[int, list[Any]]:
        """Run operations that begin an episode; return what they return, for the workers that live.

        Args:
            asked: for each worker, pairs of a method and its arguments.

        Raises:
            ValueError: an environment refuses an argument.
            EnvRaisedError: it raised something else.
        """
        return self._all(asked, self.limits.start_s)

    def look(self, asked: Mapping[int, Calls]) -> dict[int, list[Any]]:
        """Run operations that change nothing: whoever raises goes on living.

        Raises:
            ValueError: an environment refuses an argument.
            EnvRaisedError: it raised something else.
        """
        return self._all(asked, self.limits.step_s)

    def run(self, asked: Mapping[int, Calls]) -> dict[int, list[Any]]:
        """Run operations of an episode; a worker whose environment raises is lost, unless it refuses an action.

        Raises:
            ActionError: an environment refuses an action.
        """
        answers, raised = self._ask("run", asked, self.limits.step_s)
        refused = {worker for worker, error in raised.items() if error.kind == ActionError.__name__}
        for worker in raised.keys() - refused:
            self._lose(worker, f"the environment raised {raised[worker]}")
        _raise_first(raised[worker] for worker in refused)
        return answers

    def close(self) -> None:
        """Close the environments and end the processes."""
        for worker, process in enumerate(self._processes):
            if process is not None:
                process.close()
            self._processes[worker] = None

    def _all(self, asked: Mapping[int, Calls], limit_s: float) -> dict[int, list[Any]]:
        """Run operations; whatever an environment raises is raised here, and its worker lives on."""
        answers, raised = self._ask("run", asked, limit_s)
        _raise_first(raised.values())
        return answers

    def _start_all(self) -> None:
        self.start_missing()
        if any(self.lost):
            raise EnvLostError(next(filter(None, self.lost)))

    def _ask(
        self, op: str, asked: Mapping[int, object], limit_s: float
    ) -> tuple[dict[int, Any], dict[int, EnvRaisedError]]:
        """Send to all workers that live, then wait for all; return their answers, and what environments raised."""
        # All are written down before the first is sent: what cannot travel leaves no worker out of step.
        messages = {worker: message(op, value) for worker, value in asked.items()}
        sent: dict[int, EnvProcess] = {}
        for worker, pieces in messages.items():
            process = self._processes[worker]
            if process is not None:
                try:
                    process.send(pieces, limit_s)
                    sent[worker] = process
                except EnvLostError as error:
                    self._lose(worker, str(error))
        answers: dict[int, Any] = {}
        raised: dict[int, EnvRaisedError] = {}
        for worker, process in sent.items():
            try:
                answers[worker] = process.receive()
            except EnvRaisedError as error:  # noqa: PERF203 - one worker's failure is not the others'
                raised[worker] = error
            except EnvLostError as error:
                self._lose(worker, str(error))
        return answers, raised

    def _lose(self, worker: int, reason: str) -> None:
        process, self._processes[worker] = self._processes[worker], None
        if process is not None:
            process.kill()
        self.lost[worker] = reason


def _raise_first(raised: Iterable[EnvRaisedError]) -> None:
    """Raise the first of what environments raised, as the type that it was where that is a word between us."""
    for error in raised:
        known = {ActionError.__name__: ActionError, ValueError.__name__: ValueError}.get(error.kind)
        raise error if known is None else known(error.message) from None
