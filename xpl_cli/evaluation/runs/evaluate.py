"""A recorded evaluation from its request to its summary."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from xpl_cli.basics import console
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records import records, run_mode
from xpl_cli.evaluation.records.run_mode import RunMode
from xpl_cli.evaluation.rollout import backends
from xpl_cli.evaluation.rollout.backend import LOCAL, BackendConfig
from xpl_cli.evaluation.rollout.config import RolloutConfig, Runtime, ServerAccess
from xpl_cli.evaluation.rollout.in_process_backend import ExternalServer, InProcessBackend
from xpl_cli.evaluation.rollout.local_backend import LocalBackend
from xpl_cli.evaluation.rollout.servers import ManagedServer, ServerConfig
from xpl_cli.evaluation.runs import plan, runner, stopping
from xpl_cli.evaluation.runs.plan import PlanRequest
from xpl_cli.evaluation.runs.progress import show_progress
from xpl_cli.evaluation.runs.schedule import Schedule
from xpl_cli.evaluation.runs.settings import environment_for, environment_settings
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from xpl.contract import Announcement, Config
    from xpl_cli.evaluation.records.model import RunPlan
    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.rollout.backend import Backend
    from xpl_cli.evaluation.rollout.config import RecordingConfig
    from xpl_cli.evaluation.rollout.in_process_backend import ServerHandle
    from xpl_cli.evaluation.runs.remote import RemoteServer
    from xpl_cli.packages.package import Package


@dataclass(frozen=True)
class EvalRequest:
    """What to evaluate, and where the record goes.

    Attributes:
        package: the adapter.
        environment: name of the environment package; None when resuming: the record's.
        out: folder of the run.
        plan_request: tasks, settings and seeds; None when resuming: the record's.
        resume: whether an existing record is continued.
        backend_config: where rollouts run.
        films: episodes of each cell with a video.
        overrides: keys of deploy.yml.
        runtime: of adapter and environment.
        remote: an external policy server; None starts one.
        announced: its announcement.
        num_envs: episodes in one batch; None when resuming: the record's, or 1.
        env_workers: processes that share a batch.
        recording: where and how episodes are saved as trajectories.
        instruction: what the policy gets instead of the instruction, one of `run_mode.INSTRUCTIONS`.
    """

    package: Package
    environment: str | None
    out: Path
    plan_request: PlanRequest | None
    resume: bool = False
    backend_config: BackendConfig = field(default_factory=BackendConfig)
    films: int = 1
    overrides: Config = field(default_factory=dict)
    runtime: Runtime = field(default_factory=Runtime)
    remote: RemoteServer | None = None
    announced: Announcement | None = None
    num_envs: int | None = None
    env_workers: int = 1
    recording: RecordingConfig | None = None
    instruction: str | None = None


def evaluate(request: EvalRequest) -> Run:
    """Run the episodes that the record lacks, and return the run.

    Raises:
        UserError: the request cannot be met, the record is of another run or exists without `resume`, or nothing can
            run. What was recorded stays.
    """
    backends.check_backend(request.backend_config)
    if request.recording is not None and request.backend_config.backend != LOCAL:
        raise UserError(
            f"--backend {request.backend_config.backend} runs on other machines, but --record writes on this one"
        )
    exists = (request.out / records.FILE).exists()
    if exists and not request.resume:
        raise UserError(
            f"{request.out} holds a recorded run already", hint="continue it with --resume, or choose another --out"
        )
    folder, planned = _load_or_make_plan(request)
    rollout_config, server_config = make_configs(
        request.package,
        folder,
        planned,
        request.runtime,
        _isolation(request),
        env_workers=request.env_workers,
        recording=request.recording,
    )
    with records.RecordWriter(request.out, planned) as writer:
        run, is_batch = writer.run, rollout_config.num_envs > 1
        # The telemetry of a batch does not separate its episodes: it has neither videos nor curves.
        schedule = Schedule(
            run, 0 if is_batch else request.films, _stop_rule(run.plan.until_width), traced=not is_batch
        )
        if schedule.is_done:
            return records.read(request.out)
        with (
            contextlib.closing(_backend(request, rollout_config, server_config, schedule.left)) as backend,
            show_progress(run, schedule.left) as progress_view,
        ):
            runner.run_schedule(writer, backend, schedule, progress_view)
    return records.read(request.out)


def _load_or_make_plan(request: EvalRequest) -> tuple[Path, RunPlan]:
    """Return the folder of the environment, and the plan: the record's where the request leaves it to that."""
    if request.plan_request is None and (request.out / records.FILE).exists():
        recorded = records.read(request.out).plan
        folder = environments.find(request.environment or recorded.environment.name)
        before = run_mode.run_mode_of(recorded)
        if before.announced is not None and request.remote is None:
            raise UserError("this run began with an external policy server: name it with --connect")
        count = before.num_envs if request.num_envs is None else request.num_envs
        how = replace(before, num_envs=count, announced=request.announced)
        return folder, plan.refreshed_plan(recorded, request.package, folder, how)
    folder = environments.find(request.environment or environment_for())
    config = request.package.config(request.overrides)
    how = RunMode(request.num_envs or 1, request.announced, request.instruction)
    planned = plan.make_plan(request.package, folder, config, request.plan_request or PlanRequest(), how)
    for task, reason in planned.left_out.items():
        console.note(f"{task} is left out: it does not support {planned.plan.embodiment} ({reason})")
    return folder, planned.plan


def _stop_rule(width: float | None) -> Callable[[Sequence[bool | None]], bool]:
    """Return a function that tells whether a cell may end."""
    if width is None:
        return lambda _outcomes: False

    def enough(outcomes: Sequence[bool | None]) -> bool:
        return stopping.stopping_point(outcomes, width) is not None

    return enough


def _backend(
    request: EvalRequest, rollout_config: RolloutConfig, server_config: ServerConfig, episodes: int
) -> Backend:
    """Return the backend of a run.

    Raises:
        UserError: a cluster supports neither batches nor external servers.
    """
    remote = request.remote
    if remote is None and rollout_config.num_envs == 1:
        return backends.make_backend(request.backend_config, rollout_config, server_config, episodes)
    if request.backend_config.backend != LOCAL:
        raise UserError(f"--backend {request.backend_config.backend} starts its own servers and supports no batches")
    server, access = policy_server(remote, server_config)
    if rollout_config.num_envs > 1:
        return InProcessBackend(rollout_config, server, access)
    workers = min(request.backend_config.workers or 1, max(1, episodes))
    return LocalBackend(rollout_config, [(server, access)] * workers)


def policy_server(remote: RemoteServer | None, server_config: ServerConfig) -> tuple[ServerHandle, ServerAccess]:
    """Return the policy server, and how to reach it.

    Args:
        remote: an external server; None for one of ours.
        server_config: how ours is started.
    """
    if remote is None:
        server = ManagedServer(server_config, 1)
        return server, ServerAccess(server.token)
    return ExternalServer(remote.url), ServerAccess(remote.token, is_patient=True, ca_file=remote.ca_file)


def make_configs(  # noqa: PLR0913 - all that travels with a run
    package: Package,
    folder: Path,
    planned: RunPlan,
    runtime: Runtime,
    bounds: IsolationSettings,
    *,
    env_workers: int = 1,
    recording: RecordingConfig | None = None,
) -> tuple[RolloutConfig, ServerConfig]:
    """Return the configurations of rollout workers and servers.

    Args:
        package: the adapter.
        folder: of the environment package.
        planned: the plan.
        runtime: of adapter and environment.
        bounds: isolation of the adapter.
        env_workers: processes that share a batch, if there is one.
        recording: where and how episodes are saved as trajectories.

    Raises:
        UserError: the environment does not offer what the plan requires.
    """
    config, how = run_mode.without_run_mode(planned.policy.config), run_mode.run_mode_of(planned)
    cell = planned.cells[0]
    settings = environment_settings(package, str(folder), config, task=cell.task, setting=cell.setting)
    rollout_config = RolloutConfig(
        policy=str(package.path),
        policy_digest=planned.policy.digest,
        environment=str(folder),
        environment_digest=planned.environment.digest,
        config=config,
        settings=settings,
        horizon=planned.control.horizon,
        eval_env=runtime.eval_env,
        num_envs=how.num_envs,
        env_workers=min(env_workers, how.num_envs),
        bounds=bounds,
        recording=recording,
        instruction=how.instruction,
    )
    server_config = ServerConfig(
        policy=str(package.path),
        policy_digest=planned.policy.digest,
        checkpoint_digest=planned.policy.weights,
        overrides=config,
        python=runtime.python,
        env=runtime.env,
        gpu=runtime.gpu,
        bounds=bounds,
    )
    return rollout_config, server_config


def _isolation(request: EvalRequest) -> IsolationSettings:
    """Return the isolation of the adapter; on a cluster only the requested part: each machine adds its own."""
    if request.backend_config.backend != LOCAL:
        return IsolationSettings(isolate=request.runtime.isolate)
    return IsolationSettings.strictest(request.package.path.parent, isolate=request.runtime.isolate)


def check_complete(run: Run) -> None:
    """Raise where episodes of a run ended with an infrastructure error.

    Raises:
        UserError: some did, after all of their attempts.
    """
    if run.infrastructure_errors:
        raise UserError(
            f"{run.infrastructure_errors} of {len(run.finals)} episodes ended with an infrastructure error and count "
            "as failed",
            code=ExitCode.NOT_RUN,
        )
