"""What a benchmark's launcher found, as a recorded run like any other: one plan, one line for each layout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl import get_embodiment
from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.records.failures import SUCCESS, TASK
from xpl_cli.evaluation.records.fingerprints import checkpoint_of, machine_facts, package_digest
from xpl_cli.evaluation.records.model import (
    Control,
    Episode,
    Plan,
    PlannedCell,
    PlannedEnvironment,
    PlannedPolicy,
)
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from xpl.contract import Config
    from xpl.manifest import EnvManifest
    from xpl_cli.evaluation.hand_over.results import Layout
    from xpl_cli.packages.package import Package

NO_SUCCESS = "no_success"
CLEAN, RANDOMIZED = "clean", "randomized"


@dataclass(frozen=True)
class Played:
    """What a benchmark has played.

    Attributes:
        package: the adapter.
        config: its configuration.
        environment: folder of the environment package, which declares the launcher.
        facts: its env.yml.
        started: when the launcher was called.
        seconds: how long it took.
        launcher: facts about what played, which count as facts of the machine.
    """

    package: Package
    config: Config
    environment: Path
    facts: EnvManifest
    started: str
    seconds: float
    launcher: Mapping[str, str]


def write(folder: Path, played: Played, layouts: Sequence[Layout]) -> None:
    """Write the record of a run.

    Args:
        folder: of the run; nothing is recorded in it yet.
        played: by whom, and with what.
        layouts: what the benchmark says of each.

    Raises:
        UserError: there is nothing to record, or it cannot be written.
    """
    package, config, facts = played.package, played.config, played.facts
    if not layouts:
        raise UserError("the benchmark tells of no episode: nothing can be recorded")
    task, setting = place(str(config[sdk.Deploy.TASK_NAME]), facts.hand_over.randomized if facts.hand_over else None)
    robot = get_embodiment(str(config[sdk.Deploy.ENV_CFG_TYPE])).name
    entry = facts.tasks.get(config[sdk.Deploy.TASK_NAME])
    numbers = [layout.number for layout in layouts]
    plan = Plan(
        policy=PlannedPolicy(
            package.name, spec.VERSION, package_digest(package.path), dict(config), checkpoint_of(package, config)
        ),
        environment=PlannedEnvironment(facts.name, spec.VERSION, package_digest(played.environment)),
        embodiment=robot,
        action_type=config[sdk.Deploy.ACTION_TYPE],
        control=Control(horizon=None, attempts=1),
        cells=[PlannedCell(task, setting, None if entry is None else entry.dimension, numbers, frozen=True)],
    )
    with records.Writer(folder, plan.named()) as writer:
        machine = writer.machine({**machine_facts(), **played.launcher})
        for slot, layout in zip(plan.slots(), layouts, strict=True):
            episode = Episode(
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
                started=played.started,
                # A benchmark tells no times of single episodes.
                wall_seconds=round(played.seconds / len(layouts), 3),
                machine=machine,
            )
            writer.add(episode)


def place(task_name: str, randomized: str | None) -> tuple[str, str]:
    """Return task and setting of a benchmark's task, as `xpl leaderboard --format` writes them back."""
    if randomized and task_name.endswith(randomized):
        return task_name.removesuffix(randomized), RANDOMIZED
    return task_name, CLEAN
