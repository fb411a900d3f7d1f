"""Record the results of a benchmark's launcher as a run: one plan, one line for each layout."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl import get_embodiment
from xpl_cli.basics import files
from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.records.containment import LAUNCHER
from xpl_cli.evaluation.records.failures import SUCCESS, TASK
from xpl_cli.evaluation.records.fingerprints import checkpoint_of, machine_facts, package_digest
from xpl_cli.evaluation.records.model import (
    Control,
    EpisodeRecord,
    PlannedCell,
    PlannedEnvironment,
    PlannedPolicy,
    RunPlan,
)
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.evaluation.hand_over.request import HandOverPlan as HandedOver
    from xpl_cli.evaluation.hand_over.request import HandOverRequest
    from xpl_cli.evaluation.hand_over.results import LayoutResult
    from xpl_cli.evaluation.records.model import AttemptExecution

NO_SUCCESS = "no_success"
CLEAN, RANDOMIZED = "clean", "randomized"


def write(
    request: HandOverRequest,
    planned: HandedOver,
    result: Path,
    layouts: Sequence[LayoutResult],
    execution: AttemptExecution,
) -> None:
    """Write the record of a run; the launcher counts as a fact of the machine.

    Args:
        request: names the adapter, and the folder of the run, in which nothing is recorded yet.
        planned: the plan of the hand-over.
        result: the file that the benchmark wrote.
        layouts: results in that file.
        execution: start and duration of the launcher.

    Raises:
        UserError: there is nothing to record, or it cannot be written.
    """
    package, config, facts = request.package, planned.config, planned.facts
    assert request.out is not None  # noqa: S101 - for the type checker: the caller has checked
    if not layouts:
        raise UserError("the benchmark reports no episode: there is nothing to record")
    task, setting = task_and_setting(
        str(config[sdk.Deploy.TASK_NAME]), facts.hand_over.randomized if facts.hand_over else None
    )
    robot = get_embodiment(str(config[sdk.Deploy.ENV_CFG_TYPE])).name
    entry = facts.tasks.get(config[sdk.Deploy.TASK_NAME])
    numbers = [layout.number for layout in layouts]
    plan = RunPlan(
        policy=PlannedPolicy(
            package.name, spec.VERSION, package_digest(package.path), dict(config), checkpoint_of(package, config)
        ),
        environment=PlannedEnvironment(facts.name, spec.VERSION, package_digest(planned.folder)),
        embodiment=robot,
        action_type=config[sdk.Deploy.ACTION_TYPE],
        control=Control(horizon=None, attempts=1),
        cells=[PlannedCell(task, setting, None if entry is None else entry.dimension, numbers, frozen=True)],
    )
    launcher = {
        LAUNCHER: " ".join(planned.launcher.entry.command[:2]),
        "launcher_result": hashlib.sha256(files.read_regular(result)).hexdigest(),
        "launcher_run": planned.values["run_id"],
    }
    with records.RecordWriter(request.out, plan.named()) as writer:
        machine = writer.machine({**machine_facts(), **launcher})
        for slot, layout in zip(plan.slots(), layouts, strict=True):
            episode = EpisodeRecord(
                index=slot.index,
                attempt=1,
                final=True,
                task=task,
                setting=setting,
                seed=slot.seed,
                embodiment=robot,
                action_type=plan.action_type,
                success=layout.success,
                score=layout.score,
                failure=None if layout.success else TASK,
                end_reason=SUCCESS if layout.success else NO_SUCCESS,
                started=execution.started,
                # A benchmark reports no times of single episodes.
                wall_seconds=round(execution.wall_seconds / len(layouts), 3),
                machine=machine,
            )
            writer.add(episode)


def task_and_setting(task_name: str, randomized: str | None) -> tuple[str, str]:
    """Return task and setting of a benchmark's task, as `xpl leaderboard --format` writes them back."""
    if randomized and task_name.endswith(randomized):
        return task_name.removesuffix(randomized), RANDOMIZED
    return task_name, CLEAN
