"""The plan of a run: tasks, settings and seeds, fixed before the first episode."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl import get_embodiment
from xpl_cli.basics.errors import NotFoundError, UserError
from xpl_cli.environments import check, rollout
from xpl_cli.evaluation.records.fingerprints import checkpoint_of, digest_of, package_digest
from xpl_cli.evaluation.records.model import Control, PlannedCell, PlannedEnvironment, PlannedPolicy, RunPlan
from xpl_cli.evaluation.records.run_mode import RunMode, without_run_mode
from xpl_cli.evaluation.runs.stopping import episodes_needed
from xpl_cli.packages import environments, robots
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl.contract import Config
    from xpl.manifest import EnvManifest
    from xpl_cli.packages.package import Package

ALL = "all"
ATTEMPTS = 3


@dataclass(frozen=True)
class PlanRequest:
    """Which tasks, settings and seeds of an environment to run.

    Attributes:
        tasks: names of tasks or splits, or `all` that support the robot; None for deploy.yml's task, or the first.
        settings: names, or `all`; None for the first.
        episodes: of each cell; None for 1, or with `until_width` as many as that may take, as far as there are seeds.
        first: index of the first seed among the environment's evaluation seeds; without these, the seed itself.
        horizon: execution horizon, at most; None leaves it to the adapter's loop.
        until_width: a cell may end before its last seed, once the interval of its success rate is no wider.
        is_practice: seeds count up from `first`, without the environment's evaluation seeds: for training.
    """

    tasks: str | None = None
    settings: str | None = None
    episodes: int | None = None
    first: int = 0
    horizon: int | None = None
    until_width: float | None = None
    is_practice: bool = False


@dataclass(frozen=True)
class NewPlan:
    """A plan, and what it leaves out.

    Attributes:
        plan: the plan.
        left_out: tasks that do not support the robot, with the reason.
    """

    plan: RunPlan
    left_out: dict[str, str] = field(default_factory=dict)


def make_plan(
    package: Package, folder: Path, config: Config, plan_request: PlanRequest, manner: RunMode | None = None
) -> NewPlan:
    """Return the plan of a run.

    Args:
        package: the adapter.
        folder: of the environment package.
        config: the adapter's configuration.
        plan_request: tasks, settings and seeds.
        manner: the run mode; the usual one by default.

    Raises:
        NotFoundError: the environment has no such task or setting, or not so many evaluation seeds.
        UserError: a named task does not support the robot, or a name comes twice.
    """
    facts = environments.manifest(folder)
    robot = get_embodiment(str(config[sdk.Deploy.ENV_CFG_TYPE])).name
    tasks, left_out = tasks_of(facts, plan_request.tasks or config.get(sdk.Deploy.TASK_NAME), robot)
    settings = _names("setting", plan_request.settings, facts.settings)
    cells = [_cell(folder, facts, task, setting, plan_request) for task in tasks for setting in settings]
    plan = RunPlan(
        policy=_planned_policy(
            package, spec.VERSION, {**config, **robots.recorded_description(robot)}, manner or RunMode()
        ),
        environment=PlannedEnvironment(facts.name, spec.VERSION, package_digest(folder)),
        embodiment=robot,
        action_type=config[sdk.Deploy.ACTION_TYPE],
        control=Control(plan_request.horizon, ATTEMPTS),
        cells=cells,
        until_width=plan_request.until_width,
    )
    return NewPlan(plan.named(), left_out)


def refreshed_plan(recorded: RunPlan, package: Package, folder: Path, manner: RunMode) -> RunPlan:
    """Return the plan of a record as it would be made today: with the digests of what is there now."""
    policy = _planned_policy(package, recorded.policy.spec, without_run_mode(recorded.policy.config), manner)
    environment = replace(recorded.environment, digest=package_digest(folder))
    return replace(recorded, policy=policy, environment=environment).named()


def _planned_policy(package: Package, version: str, config: Config, manner: RunMode) -> PlannedPolicy:
    """Return the policy of a plan: digests of files, or the announcement of an external server."""
    if manner.announced is not None:
        digest = digest_of(dict(manner.announced))
        return PlannedPolicy(package.name, version, digest, manner.add_to(config))
    digest, checkpoint = package_digest(package.path), checkpoint_of(package, config)
    return PlannedPolicy(package.name, version, digest, manner.add_to(config), checkpoint)


def tasks_of(facts: EnvManifest, requested: str | None, robot: str) -> tuple[list[str], dict[str, str]]:
    """Return the tasks of a plan, and those that `all` leaves out, with the reason.

    Args:
        facts: the environment's manifest.
        requested: names of tasks or splits with commas between them, or `all`; None for the first task.
        robot: name of the embodiment.

    Raises:
        NotFoundError: there is no such task.
        UserError: a named task does not support the robot, or a name comes twice.
    """
    entries = facts.tasks
    reasons = {task: rollout.unsupported(entry, robot) for task, entry in entries.items()}
    if requested == ALL:
        left_out = {task: reason for task, reason in reasons.items() if reason is not None}
        playable = [task for task in entries if task not in left_out]
        if not playable:
            raise UserError(f"{facts.name} has no task for {robot}")
        return playable, left_out
    chosen = _names("task", None if requested is None else _expand_splits(facts, requested), list(entries))
    for task in chosen:
        if reasons[task] is not None:
            raise UserError(f"{facts.name} does not offer {task} with {robot}: {reasons[task]}")
    return chosen, {}


def _expand_splits(facts: EnvManifest, requested: str) -> str:
    """Return a list with commas in which each split is replaced by its tasks."""
    names = [requested] if requested in facts.tasks else [name.strip() for name in requested.split(",")]
    _require_once("task", requested, names)
    return ",".join(rollout.expand_splits(facts, names))


def _names(what: str, requested: str | None, offered: Sequence[str]) -> list[str]:
    """Return the names in a list with commas; the first that is offered by default."""
    if requested is None:
        return [offered[0]]
    if requested == ALL:
        return list(offered)
    names = [rollout.choose_name(what, name.strip(), offered) for name in requested.split(",")]
    _require_once(what, requested, names)
    return names


def _require_once(what: str, requested: str, names: Sequence[str]) -> None:
    if len(set(names)) < len(names):
        raise UserError(f"--{what} {requested} names one of them twice")


def _cell(folder: Path, facts: EnvManifest, task: str, setting: str, plan_request: PlanRequest) -> PlannedCell:
    seeds, frozen = _seeds(folder, task, setting, plan_request)
    return PlannedCell(task, setting, facts.tasks[task].dimension, seeds, frozen)


def _seeds(folder: Path, task: str, setting: str, plan_request: PlanRequest) -> tuple[list[int], bool]:
    """Return the seeds of a cell, and whether they are the environment's evaluation seeds."""
    count = plan_request.episodes
    most = (
        episodes_needed(plan_request.until_width)
        if count is None and plan_request.until_width is not None
        else count or 1
    )
    first, end = plan_request.first, plan_request.first + most
    if plan_request.is_practice:
        tests = set(check.seeds(folder, task, setting)) if check.has_seeds(folder) else set()
        return list(itertools.islice((seed for seed in itertools.count(first) if seed not in tests), most)), False
    if not check.has_seeds(folder):
        return list(range(first, end)), False
    frozen_seeds = check.seeds(folder, task, setting)
    if end > len(frozen_seeds) and (count is not None or first >= len(frozen_seeds)):
        raise NotFoundError(
            f"{task} ({setting}) has {len(frozen_seeds)} evaluation seeds, not all of index {first} to {end - 1}",
            hint="--seed is the index of the first one, --episodes their number",
        )
    return frozen_seeds[first:end], True
