"""The service fact: one server of an adapter from start to end, with timings and processes."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.client import ClientError, PolicyServerError
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.served.compare import is_answer_list
from xpl_cli.isolation import processes
from xpl_cli.serving.launch import ServerStartError

if TYPE_CHECKING:
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.audit.served.recorded_client import Answer
    from xpl_cli.isolation.processes import ProcessInfo

USUAL_SEED = sdk.DEPLOY_DEFAULTS[sdk.Deploy.SEED]
_ASKED = 8
_TABLES = ("tcp", "tcp6")
_LISTENS = "0A"  # proc_pid_net(5): TCP_LISTEN


@dataclass
class ServiceRun:
    """One server run.

    Attributes:
        chunks: the answers to one scripted episode.
        seconds: time of each, s.
        failure: why the episode ended early, or None.
        error: the policy's answer to an observation that it did not take, or None.
        processes: the adapter's, during the episode.
        left_group: those of them that had left its process group.
        listening: TCP addresses on which the adapter listened, with the process.
        code: exit code after termination.
        stop_seconds: how long that took, s.
        survivors: processes of the adapter that outlive the server.
        log: last lines of its output.
    """

    chunks: list[Answer] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    failure: str | None = None
    error: str | None = None
    processes: list[ProcessInfo] = field(default_factory=list)
    left_group: list[tuple[ProcessInfo, str]] = field(default_factory=list)
    listening: list[tuple[str, ProcessInfo]] = field(default_factory=list)
    code: int | None = None
    stop_seconds: float = 0.0
    survivors: list[ProcessInfo] = field(default_factory=list)
    log: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, probe: Probe) -> ServiceRun:
        """Serve an adapter with the usual seed, run an episode, and stop the server.

        Raises:
            NotRun: if it does not start.
        """
        try:
            probe.server()  # fixes the choice; this server may have ended already, which rules report
        except NotRun:
            if probe.start_problem is not None:
                raise
        run = cls()
        try:
            with probe.unforked_server({sdk.Deploy.SEED: USUAL_SEED}) as server:
                goes_on = run._run_episode(probe, server.url)
                run.processes = processes.descendants(server.pid)
                if goes_on:  # while a server ends, its processes change parents
                    run._inspect_processes(server.pid, kept_apart=bool(probe.options.bounds.flags))
        except ServerStartError as error:
            raise NotRun(f"the server did not start: {error}") from None
        run.code, run.stop_seconds = server.exit_code, server.stop_seconds or 0.0
        run.survivors = [member for member in run.processes if member.is_alive]
        run.log = list(server.log)
        if run.failure is not None:
            run.failure = probe.describe_end(server.last_error or run.failure, server.log)
        return run

    @property
    def first(self) -> float:
        """Time of the first answer, s.

        Raises:
            NotRun: if not all questions were answered.
        """
        return self._answered()[0]

    @property
    def usual(self) -> float:
        """Median time of the later answers, s.

        Raises:
            NotRun: if not all questions were answered.
        """
        return median(self._answered()[1:])

    @property
    def steps(self) -> int:
        """Action steps of a chunk."""
        return len(self.chunks[-1]) if self.chunks and is_answer_list(self.chunks[-1]) else 0

    def _answered(self) -> list[float]:
        if len(self.seconds) < _ASKED:
            raise NotRun(f"the adapter does not answer a plain observation: {self.failure or self.error}")
        return self.seconds

    def _run_episode(self, probe: Probe, url: str) -> bool:
        """Run an episode, and tell whether the server still runs."""
        observations = [probe.observation(0, step) for step in range(_ASKED)]
        try:
            with probe.connected(url) as policy:
                policy.reset()
                for obs in observations:
                    started = time.perf_counter()
                    updated, answer = policy.update_obs(obs), policy.get_action()
                    for failed in (updated, answer):
                        if isinstance(failed, PolicyServerError):
                            self.error = str(failed)
                            self.failure = self.error if failed.is_infrastructure_error else None
                            return True
                    self.seconds.append(time.perf_counter() - started)
                    self.chunks.append(answer)
        except ClientError as error:
            self.failure = str(error)
            return False
        return True

    def _inspect_processes(self, front_end: int, *, kept_apart: bool) -> None:
        workers = [member.pid for member in self.processes if member.parent == front_end and member.group == member.pid]
        own_pids = {pid for one in workers for pid in (processes.launcher_chain(one) if kept_apart else [one])}
        groups = {member.group for member in self.processes if member.pid in own_pids}
        for member in self.processes:
            # The worker leads its group; a child that leads one, or that the front end had to adopt, has left.
            if member.group not in groups or (member.group == member.pid and member.pid not in own_pids):
                self.left_group.append((member, member.command))
            self.listening += [(address, member) for address in _listening(member.pid)]


def _listening(pid: int) -> list[str]:
    """Return the TCP addresses on which a process listens."""
    sockets = set()
    with contextlib.suppress(OSError):
        for descriptor in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                sockets.add(descriptor.readlink().name)
    addresses = []
    for table in _TABLES:
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/{pid}/net/{table}").read_text(encoding="ascii").splitlines()[1:]:
                columns = line.split()
                if columns[3] == _LISTENS and f"socket:[{columns[9]}]" in sockets:
                    addresses.append(f"port {int(columns[1].rpartition(':')[2], 16)}")
    return addresses
