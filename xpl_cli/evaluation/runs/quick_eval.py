"""An evaluation without a record: some episodes of one or several tasks, reported at once (`xpl.eval/1`).

Rollout worker and rules are those of a recorded run. The differences: the user names the seeds, several environments
may form one batch, the server may already run, and the first episode that the policy breaks off ends the evaluation.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

from xpl import _spec as sdk
from xpl import get_embodiment
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records.failures import POLICY_DIED, POLICY_ERROR
from xpl_cli.evaluation.records.fingerprints import package_digest
from xpl_cli.evaluation.records.model import Control, PlannedCell, PlannedEnvironment, PlannedPolicy, RunPlan
from xpl_cli.evaluation.records.records import InMemoryRecord
from xpl_cli.evaluation.records.run_mode import RunMode
from xpl_cli.evaluation.rollout.config import Runtime
from xpl_cli.evaluation.rollout.in_process_backend import InProcessBackend
from xpl_cli.evaluation.runs import evaluate as suite
from xpl_cli.evaluation.runs import evaluation, runner
from xpl_cli.evaluation.runs.evaluation import EvalSetup, Evaluation
from xpl_cli.evaluation.runs.plan import ALL, ATTEMPTS, tasks_of
from xpl_cli.evaluation.runs.schedule import Schedule
from xpl_cli.evaluation.runs.settings import environment_settings
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.packages import environments
from xpl_cli.standard import spec

_DIGITS = 10
"""No machine has that many processes; a longer number is none that was meant."""

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from xpl.contract import Config
    from xpl.manifest import EnvManifest
    from xpl_cli.basics.progress import Progress
    from xpl_cli.evaluation.records.model import CellKey, EpisodeRecord
    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.rollout.config import EnvSettings, RecordingConfig
    from xpl_cli.evaluation.runs.remote import RemoteServer
    from xpl_cli.packages.package import Package


@dataclass(frozen=True)
class QuickEvalRequest:
    """What to evaluate.

    Attributes:
        package: the adapter.
        environment: name of the environment package.
        task: task of it, its first one by default; or several: with commas between them, splits, or `all`.
        setting: setting of it, its first one by default.
        episodes: number of episodes of each task.
        num_envs: environments in one batch.
        workers: processes that share them; 0 runs them in this process.
        horizon: execution horizon, at most; None leaves it to the adapter's loop.
        overrides: keys of deploy.yml.
        remote: a server that already runs; None starts one.
        runtime: of adapter and environment.
        recording: where and how episodes are saved as trajectories.
    """

    package: Package
    environment: str
    task: str | None = None
    setting: str | None = None
    episodes: int = 1
    num_envs: int = 1
    workers: int = 1
    horizon: int | None = None
    overrides: Config = field(default_factory=dict)
    remote: RemoteServer | None = None
    runtime: Runtime = field(default_factory=Runtime)
    recording: RecordingConfig | None = None


def num_envs_and_workers(num_envs: int | None, workers: str) -> tuple[int, int]:
    """Return the number of environments in a batch, and of processes that share them.

    Args:
        num_envs: environments, or None for one per process.
        workers: number of processes; "0" for this one, "auto" for one per core, at most one per environment.

    Raises:
        UserError: `workers` is invalid, or greater than `num_envs`.
    """
    if workers == "auto":
        cores = len(os.sched_getaffinity(0))
        return (cores, cores) if num_envs is None else (num_envs, min(cores, num_envs))
    if not (workers.isdecimal() and len(workers) < _DIGITS):
        raise UserError(f"--workers must be a number or auto, got {workers[:_DIGITS]!r}")
    count = int(workers)
    if num_envs is not None and count > num_envs:
        raise UserError(f"{count} workers for {num_envs} environments: leave --num-envs out, or use fewer workers")
    return (max(1, count) if num_envs is None else num_envs), count


def evaluate(request: QuickEvalRequest, progress: Progress) -> Evaluation:
    """Run the episodes and return the result.

    Raises:
        UserError: the environment does not know the task or embodiment or cannot run, policy and environment do not
            fit, or the policy breaks an episode off.
    """
    started = time.perf_counter()
    config = request.package.config(request.overrides)
    folder = environments.find(request.environment)
    facts = environments.manifest(folder)
    tasks = _task_list(request.task, facts, str(config[sdk.Deploy.ENV_CFG_TYPE]))
    task = tasks[0] if tasks else request.task
    settings = environment_settings(request.package, request.environment, config, task=task, setting=request.setting)
    setting = request.setting or facts.settings[0]
    tasks = tasks or [cast("str", settings.task)]  # None in the offline environment, and in its report
    sink = InMemoryRecord(_plan(request, folder, config, settings, [(task, setting) for task in tasks]))
    schedule = Schedule(sink.run, 0, lambda _outcomes: False, traced=False)
    with contextlib.closing(_backend(request, folder, sink.run.plan, progress)) as backend:
        backend.prepare(tasks[0], setting)
        runner.run_schedule(sink, backend, schedule, _View(sink.run, request.episodes * len(tasks), progress))
    setup = EvalSetup(
        policy=request.package.name,
        environment=request.environment,
        task=settings.task if len(tasks) == 1 else request.task,
        setting=setting,
        embodiment=sink.run.plan.embodiment,
        action_type=sink.run.plan.action_type,
        num_envs=request.num_envs,
        workers=request.workers,
        horizon=request.horizon,
    )
    finals = [sink.run.finals[index] for index in sorted(sink.run.finals)]
    attempts = Counter(episode.index for episode in sink.run.attempts)
    return Evaluation(setup, finals, attempts, time.perf_counter() - started)


class _View:
    """Shows the progress, and ends the evaluation if the policy breaks an episode off.

    Args:
        run: the record in memory; it grows.
        total: number of episodes.
        progress: where to show it.
    """

    def __init__(self, run: Run, total: int, progress: Progress) -> None:
        self._run, self._total, self._progress = run, total, progress

    def add(self, line: EpisodeRecord, left: int) -> None:  # noqa: ARG002 - as every view
        """Show a line.

        Raises:
            UserError: the policy broke the episode off in its last attempt.
        """
        where = f"episode with seed {line.seed}"
        if not line.final:
            self._progress.step(f"{where}: {line.error}; the trial does not count")
            return
        if line.end_reason in (POLICY_ERROR, POLICY_DIED):
            raise UserError(f"{where}: {line.error}", code=ExitCode.FINDINGS)
        self._progress.step(evaluation.progress_line(list(self._run.finals.values()), self._total))


def _task_list(requested: str | None, facts: EnvManifest, embodiment: str) -> list[str]:
    """Return the tasks where more than one is meant, or a split; nothing where one or none is named."""
    if requested is None or requested in facts.tasks:
        return []
    is_list = requested == ALL or "," in requested or requested in facts.splits
    return tasks_of(facts, requested, get_embodiment(embodiment).name)[0] if is_list else []


def _plan(
    request: QuickEvalRequest, folder: Path, config: Config, settings: EnvSettings, cells: Sequence[CellKey]
) -> RunPlan:
    """Return the plan of an evaluation without a record; it has digests if trajectories are saved."""
    policy = environment = ""
    if request.recording is not None:
        policy, environment = package_digest(request.package.path), package_digest(folder)
    first = int(config[sdk.Deploy.SEED])
    seeds = range(first, first + request.episodes)
    config_with_mode = RunMode(request.num_envs).add_to(config)
    return RunPlan(
        policy=PlannedPolicy(request.package.name, spec.VERSION, policy, config_with_mode),
        environment=PlannedEnvironment(environments.manifest(folder).name, spec.VERSION, environment),
        embodiment=settings.embodiment,
        action_type=settings.action_type,
        control=Control(request.horizon, ATTEMPTS),
        cells=[PlannedCell(task, setting, None, seeds, frozen=False) for task, setting in cells],
    )


def _backend(request: QuickEvalRequest, folder: Path, planned: RunPlan, progress: Progress) -> InProcessBackend:
    rollout_config, server_config = suite.make_configs(
        request.package,
        folder,
        planned,
        request.runtime,
        IsolationSettings.strictest(request.package.path.parent, isolate=request.runtime.isolate),
        env_workers=request.workers,
        recording=request.recording,
    )
    server, access = suite.policy_server(request.remote, server_config)

    def on_loading(status: Mapping[str, Any]) -> None:
        progress.step(f"the model is loading: {status.get('seconds', 0):.0f} s")

    return InProcessBackend(rollout_config, server, replace(access, is_patient=True, on_loading=on_loading))
