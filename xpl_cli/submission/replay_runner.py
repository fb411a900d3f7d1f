"""Run episodes of a bundle again: serve the adapter, use the environment here, record nothing."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.vector import INFRASTRUCTURE
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.progress import Progress
from xpl_cli.evaluation.records import fingerprints
from xpl_cli.evaluation.rollout.backend import RolloutJob
from xpl_cli.evaluation.rollout.config import Runtime
from xpl_cli.evaluation.rollout.local_backend import LocalBackend, assign_servers
from xpl_cli.evaluation.runs import evaluate, runner
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.lifecycle.checkpoints import fetch, specification
from xpl_cli.packages import environments, package, robots
from xpl_cli.submission import claims
from xpl_cli.submission.replay import ReplayPair

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl.contract import Config
    from xpl_cli.evaluation.records.fingerprints import LoadedCheckpoint
    from xpl_cli.evaluation.records.model import EpisodeRecord, PlannedEpisode
    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.rollout.config import RolloutConfig
    from xpl_cli.evaluation.rollout.servers import ServerConfig
    from xpl_cli.packages.package import Package


@dataclass(frozen=True)
class ReplayRunner:
    """Replays episodes with the adapter of a bundle.

    Attributes:
        policy: its folder.
        variant: of the runs; None for the policy itself.
        is_ours: whether the adapter is not the bundle's own: then it has its weights.
        runtime: of adapter and environment.
        progress: where to report progress.
    """

    policy: Path
    variant: str | None = None
    is_ours: bool = False
    runtime: Runtime = field(default_factory=Runtime)
    progress: Progress = field(default_factory=Progress)

    @cached_property
    def _package(self) -> Package:
        return package.load(self.policy, {sdk.Deploy.VARIANT: self.variant})

    @property
    def is_deterministic(self) -> bool:
        """Whether the policy declares that it repeats itself."""
        return bool(self._package.manifest.deterministic)

    def replay(self, run: Run, indices: Sequence[int]) -> list[ReplayPair]:
        """Run some episodes of a run as its plan says.

        Args:
            run: the run.
            indices: of the episodes.

        Raises:
            UserError: the adapter, its weights or the environment are missing, or are not those of the run.
        """
        if not indices:
            return []
        here = fingerprints.digest_of(fingerprints.machine_facts())
        lines = self._lines(run, indices)
        return [
            ReplayPair(run.finals[index], lines[index], is_equal_machine=run.finals[index].machine == here)
            for index in indices
        ]

    def _lines(self, run: Run, indices: Sequence[int]) -> dict[int, EpisodeRecord]:
        """Return the line of each episode; infrastructure errors are retried, as in any run."""
        slots = run.plan.slots()
        lines: dict[int, EpisodeRecord] = {}
        with contextlib.closing(self._backend(run)) as backend:
            for attempt in range(1, run.plan.control.attempts + 1):
                jobs = [_job(slots[index], attempt) for index in indices if _is_open(lines.get(index))]
                for line in runner.rerun_episodes(run.plan, jobs, backend):
                    self.progress.step(f"replay: episode {line.index}, {line.task}: {line.end_reason}")
                    lines[line.index] = line
        return lines

    def _backend(self, run: Run) -> LocalBackend:
        rollout_config, server_config = self._configs(run)
        return LocalBackend(rollout_config, assign_servers(server_config, 1, 1))

    def _configs(self, run: Run) -> tuple[RolloutConfig, ServerConfig]:
        """Return the configurations of rollout worker and server, checked against the record."""
        plan = run.plan
        adapter = self._package
        if fingerprints.package_digest(adapter.path) != plan.policy.digest:
            raise UserError(
                f"{adapter.path} does not have the files of the run: it cannot replace the bundle's adapter"
            )
        config = plan.policy.config
        robots.register_recorded(config, f"run {plan.run[:12]}")
        self._require_checkpoint(config, plan.policy.checkpoint)
        folder = claims.environment_folder(run)
        facts = environments.manifest(folder)
        if facts.is_real:
            raise UserError(f"{folder.name} does not wait for the policy: no episode repeats", code=ExitCode.NOT_RUN)
        if fingerprints.package_digest(folder) != plan.environment.digest:
            raise UserError(f"{folder.name} here is another version than the run's", code=ExitCode.NOT_RUN)
        bounds = IsolationSettings.strictest(adapter.path.parent, isolate=self.runtime.isolate)
        return evaluate.make_configs(adapter, folder, plan, self.runtime, bounds)

    def _require_checkpoint(self, config: Config, loaded: LoadedCheckpoint | None) -> None:
        """See to it that the adapter loads the checkpoint of the run.

        Raises:
            UserError: it is not here.
        """
        if loaded is not None and not self.is_ours:
            self._link(loaded.digest)
        checkpoint = fingerprints.checkpoint_of(self._package, config)
        if (checkpoint and checkpoint.digest) != (loaded and loaded.digest):
            raise UserError(
                f"the checkpoint of the run ({loaded.path if loaded else 'none'}) is not here",
                hint="`xpl verify --unpack DIR --sample 0`, then `xpl checkpoint fetch` for the adapter in DIR, then "
                "`xpl verify`; or --policy names an adapter that has it",
                code=ExitCode.NOT_RUN,
            )

    def _link(self, digest: str) -> None:
        """Let the adapter of a bundle find a checkpoint that was fetched."""
        for one in specification.declared_checkpoints(self._package).values():
            if one.digest == digest and (path := fetch.local_path(one)) is not None:
                fetch.link(self._package.path, one.name, path)


def _job(slot: PlannedEpisode, attempt: int) -> RolloutJob:
    return RolloutJob(slot.index, attempt, slot.task, slot.setting, slot.seed, trace=False)


def _is_open(line: EpisodeRecord | None) -> bool:
    return line is None or line.failure == INFRASTRUCTURE
