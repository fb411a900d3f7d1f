"""Record demonstrations: run episodes on seeds that no evaluation uses, until enough are saved as trajectories.

    demos/episode_0000000.hdf5, ...   the trajectories; the number is the episode's index in the plan
    demos/index.jsonl                 their lengths and contents
    demos/run/                        the record of the run: every attempt, also discarded ones

The evaluation engine runs the rollouts.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl.vector import INFRASTRUCTURE
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.environments import rollout
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.rollout import backends, trajectory_recorder
from xpl_cli.evaluation.rollout.backend import LOCAL, BackendConfig
from xpl_cli.evaluation.rollout.config import Runtime
from xpl_cli.evaluation.runs import evaluate, plan, runner
from xpl_cli.evaluation.runs.plan import PlanRequest
from xpl_cli.evaluation.runs.schedule import Schedule
from xpl_cli.isolation.isolation_settings import IsolationSettings
from xpl_cli.packages import environments, package

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from xpl.contract import Config
    from xpl_cli.basics.progress import Progress
    from xpl_cli.evaluation.records.model import EpisodeRecord
    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.rollout.config import RecordingConfig
    from xpl_cli.packages.package import Package

RUN, SURPLUS = "run", ".surplus"
_MIN_SEEDS: Final = 1000
"""Seeds of a plan, at least: a set may grow later without becoming another one."""
_MAX_TRIES, _MIN_TRIES = 4, 20
"""A task ends after this many times the requested episodes, or after this many without a saved one."""


@dataclass(frozen=True)
class RecordRequest:
    """What to record, and where it goes.

    Attributes:
        environment: name of an environment package, or its folder.
        tasks, setting: of it; the first by default. Tasks are a list with commas, names of splits, or `all`.
        embodiment, action_type: of it; the first that the task is offered with by default.
        policy: adapter that acts; the environment's scripted expert by default.
        episodes: number to save of each task.
        seed: the first one.
        recording: the set.
        size: height and width of images, True for the environment's own, False for none; None for what the policy
            reads, or the environment's own if it reads none.
        horizon: execution horizon, at most; None leaves it to the adapter's loop.
        films: episodes of each task with a video.
        workers: rollout workers; None for one per core.
        resume: whether an existing set is continued.
        overrides: keys of deploy.yml.
        runtime: of policy and environment.
    """

    environment: str
    recording: RecordingConfig
    tasks: str | None = None
    setting: str | None = None
    embodiment: str | None = None
    action_type: str | None = None
    policy: str | None = None
    episodes: int = 50
    seed: int = 0
    size: tuple[int, int] | bool | None = None
    horizon: int | None = None
    films: int = 0
    workers: int | None = 1
    resume: bool = False
    overrides: Config | None = None
    runtime: Runtime = field(default_factory=Runtime)


@dataclass(frozen=True)
class TaskDemonstrations:
    """The content of a set for one task in one setting.

    Attributes:
        task, setting: of the environment.
        episodes, requested: numbers of saved and of requested episodes.
        tried: episodes that were run for them.
        discarded, infrastructure_errors: of these, not to be saved, and ended with an infrastructure error.
        steps: of the saved episodes.
    """

    task: str
    setting: str
    episodes: int
    requested: int
    tried: int
    discarded: int
    infrastructure_errors: int
    steps: int


@dataclass(frozen=True)
class DemonstrationSet:
    """The content of a set (`xpl.demonstrations/1`).

    Attributes:
        folder: of the set.
        environment, embodiment, action_type, policy: of the rollouts.
        keep: one of `config.KEEP`.
        tasks: task by task.
        episodes, steps: of all tasks.
        bytes: of all files.
        seconds: duration of the recording.
    """

    folder: str
    environment: str
    embodiment: str
    action_type: str
    policy: str
    keep: str
    tasks: Sequence[TaskDemonstrations]
    episodes: int
    steps: int
    bytes: int
    seconds: float

    @property
    def is_complete(self) -> bool:
        """Whether there are as many episodes as were requested."""
        return all(task.episodes >= task.requested for task in self.tasks)

    def text(self) -> str:
        """Return what the set holds, for people."""
        lines = []
        for task in self.tasks:
            rest = [f"{task.discarded} of {task.tried} tries discarded"] if task.discarded else []
            rest += [f"{task.infrastructure_errors} infrastructure errors"] if task.infrastructure_errors else []
            short = f" of {task.requested} requested" if task.episodes < task.requested else ""
            lines.append(", ".join([f"{task.task}: {task.episodes} episodes{short}", f"{task.steps} steps", *rest]))
        return "\n".join([*lines, f"{self.folder}: {self.episodes} episodes, {self.bytes / 1e6:.1f} MB"])


def collect(request: RecordRequest, progress: Progress) -> DemonstrationSet:
    """Record until the set is complete, and return its content.

    Raises:
        UserError: no policy can act, the request cannot be met, the set is another one or exists without `resume`, or
            nothing can run. What was recorded stays.
    """
    trajectory_recorder.require_library()
    adapter = _load_player(request)
    folder = Path(request.recording.folder)
    run = folder / RUN
    if (run / records.FILE).exists() and not request.resume:
        raise UserError(
            f"{folder} holds demonstrations already", hint="continue with --resume, or choose another --out"
        )
    overrides, plan_request = _plan_request(request)
    environment = environments.find(request.environment)
    planned = plan.make_plan(adapter, environment, adapter.config(overrides), plan_request).plan
    bounds = IsolationSettings.strictest(adapter.path.parent, isolate=request.runtime.isolate)
    rollout_config, server_config = evaluate.make_configs(
        adapter, environment, planned, request.runtime, bounds, recording=request.recording
    )
    cameras = request.size if request.size is not None else rollout_config.settings.cameras or True
    rollout_config = replace(rollout_config, settings=replace(rollout_config.settings, cameras=cameras))
    _restore_surplus(folder)
    began = time.monotonic()
    with records.RecordWriter(run, planned) as writer:
        keep = request.recording.keep
        schedule = Schedule(
            writer.run,
            request.films,
            _stop_rule(request.episodes),
            traced=False,
            judge=lambda final: trajectory_recorder.is_kept(final, keep),
        )
        before = sum(map(len, _saved_episodes(writer.run, request)))
        if not schedule.is_done:
            backend_config = BackendConfig(LOCAL, request.workers)
            with contextlib.closing(
                backends.make_backend(backend_config, rollout_config, server_config, schedule.left)
            ) as backend:
                progress_view = _RecordProgress(writer.run, request, before, progress)
                runner.run_schedule(writer, backend, schedule, progress_view, ahead=False)
    return _summary(records.read(run), request, adapter.name, time.monotonic() - began)


def _load_player(request: RecordRequest) -> Package:
    """Return the adapter that acts.

    Raises:
        NotFoundError: the environment names no expert, and the request names no policy.
    """
    facts = environments.manifest(environments.find(request.environment))
    name = request.policy or facts.expert
    if name is not None:
        return package.load(name, request.overrides)
    raise NotFoundError(
        f"{request.environment} has no scripted expert",
        hint="name a policy with --policy: for a robot, one that reads the leader arm of teleoperation",
    )


def _plan_request(request: RecordRequest) -> tuple[Config, PlanRequest]:
    """Return the overrides of deploy.yml, and the plan request."""
    first = None if request.tasks in (None, plan.ALL) else request.tasks.partition(",")[0]
    facts = environments.manifest(environments.find(request.environment))
    task = rollout.expand_splits(facts, [first])[0] if first else None
    scenario = rollout.make_scenario(
        request.environment,
        action_type=request.action_type,
        task=task,
        embodiment=request.embodiment,
        setting=request.setting,
    )
    overrides = {
        sdk.Deploy.ENV_CFG_TYPE: scenario.embodiment,
        sdk.Deploy.ACTION_TYPE: scenario.action_type,
        **(request.overrides or {}),
    }
    plan_request = PlanRequest(
        request.tasks or scenario.task,
        scenario.setting,
        max(_MIN_SEEDS, _MAX_TRIES * request.episodes),
        request.seed,
        request.horizon,
        is_practice=True,
    )
    return overrides, plan_request


def _stop_rule(requested: int) -> Callable[[Sequence[bool | None]], bool]:
    """Return a function that tells whether a task has all of its episodes, or will never have them."""

    def enough(outcomes: Sequence[bool | None]) -> bool:
        saved = sum(map(bool, outcomes))
        hopeless = len(outcomes) >= _MIN_TRIES and not saved
        return saved >= requested or hopeless or len(outcomes) >= max(_MIN_TRIES, _MAX_TRIES * requested)

    return enough


def _saved_episodes(run: Run, request: RecordRequest) -> list[list[EpisodeRecord]]:
    """Return the episodes of each task that belong to the set: the first ones of the plan that are to be saved.

    They do not depend on the number of workers.
    """
    cells: list[list[EpisodeRecord]] = []
    for cell in run.plan.cells:
        mine = [line for line in run.finals.values() if line.cell_key == cell.cell_key]
        cells.append([line for line in mine if trajectory_recorder.is_kept(line, request.recording.keep)])
    return cells


def _restore_surplus(folder: Path) -> None:
    """Bring back what was beyond the number that was wanted before: more may be wanted now."""
    for path in (folder / SURPLUS).glob("*.hdf5"):
        path.replace(folder / path.name)


def _summary(run: Run, request: RecordRequest, player: str, seconds: float) -> DemonstrationSet:
    """Put aside what is too much, and return what the set holds."""
    folder = Path(request.recording.folder)
    tasks, files = [], []
    for cell, lines in zip(run.plan.cells, _saved_episodes(run, request), strict=True):
        for line in lines[request.episodes :]:
            path = folder / trajectory_recorder.file_name(line.index)
            if path.exists():
                (folder / SURPLUS).mkdir(exist_ok=True)
                path.replace(folder / SURPLUS / path.name)
        mine = lines[: request.episodes]
        last = mine[-1].index if len(mine) >= request.episodes else None
        tried = [
            line
            for line in run.finals.values()
            if line.cell_key == cell.cell_key and (last is None or line.index <= last)
        ]
        errors = sum(line.failure == INFRASTRUCTURE for line in tried)
        files += [folder / trajectory_recorder.file_name(line.index) for line in mine]
        tasks.append(
            TaskDemonstrations(
                task=cell.task,
                setting=cell.setting,
                episodes=len(mine),
                requested=request.episodes,
                tried=len(tried),
                discarded=len(tried) - len(mine) - errors,
                infrastructure_errors=errors,
                steps=sum(line.steps or 0 for line in mine),
            )
        )
    existing = [path for path in files if path.is_file()]
    if len(existing) < len(files):
        lost = next(path for path in files if path not in existing)
        raise UserError(f"{lost} was recorded and is not there any more", code=ExitCode.NOT_RUN)
    return DemonstrationSet(
        folder=str(folder),
        environment=run.plan.environment.name,
        embodiment=run.plan.embodiment,
        action_type=run.plan.action_type,
        policy=player,
        keep=request.recording.keep,
        tasks=tasks,
        episodes=sum(task.episodes for task in tasks),
        steps=sum(task.steps for task in tasks),
        bytes=sum(path.stat().st_size for path in existing),
        seconds=round(seconds, 1),
    )


class _RecordProgress:
    """A progress line."""

    def __init__(self, run: Run, request: RecordRequest, before: int, progress: Progress) -> None:
        self._run, self._request, self._before, self._progress = run, request, before, progress
        self._began: float | None = None

    def add(self, line: EpisodeRecord, left: int) -> None:  # noqa: ARG002 - as every view
        """Update the line."""
        if self._began is None:  # models are loaded by now
            self._began = time.monotonic() - line.wall_seconds
        cells = _saved_episodes(self._run, self._request)
        requested = self._request.episodes
        saved = sum(min(len(lines), requested) for lines in cells)
        total, tried = requested * len(cells), len(self._run.finals)
        pace = (saved - self._before) / max(time.monotonic() - self._began, 1e-3)
        parts = [f"{line.task}: {saved} of {total} episodes", f"{tried - saved} discarded" if tried > saved else ""]
        if pace > 0:
            parts += [f"{60 * pace:.1f} a minute", f"{(total - saved) / pace / 60:.0f} min left"]
        if line.error:
            parts.append(line.error)
        self._progress.step(", ".join(filter(None, parts)))
