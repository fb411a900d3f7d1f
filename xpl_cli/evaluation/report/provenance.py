"""What was run, and on what: versions, digests, seeds, machines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.evaluation.records import run_mode
from xpl_cli.evaluation.report.number_format import many
from xpl_cli.evaluation.statistics import wording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.evaluation.records.model import PlannedCell
    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.statistics.summary_model import Summary

_MOST_RANGES = 4


@dataclass(frozen=True)
class ProvenanceItem:
    """A fact by its name; `mono`: the value is to be read letter by letter."""

    name: str
    value: str
    mono: bool


def view(run: Run, summary: Summary) -> list[ProvenanceItem]:
    """Return what was run, fact by fact; a fact without a name goes with the one before it."""
    plan = run.plan
    policy, environment, checkpoint = plan.policy, plan.environment, plan.policy.checkpoint
    horizon, attempts = plan.control.horizon, plan.control.attempts
    loop = "the adapter's own loop" if horizon is None else f"at most {horizon} actions of a chunk"
    pairs = [
        ("Run", plan.run, True),
        ("Begun", plan.created, False),
        ("Policy", f"{policy.name}, spec {policy.spec}", False),
        ("", policy.digest, True),
        ("Checkpoint", checkpoint.path if checkpoint else "none declared or found", False),
        *([("", checkpoint.digest, True)] if checkpoint else []),
        *([("Mode", unusual, False)] if (unusual := run_mode.run_mode_of(plan).description) else []),
        ("Environment", f"{environment.name}, spec {environment.spec}", False),
        ("", environment.digest, True),
        ("Embodiment", f"{plan.embodiment}, {plan.action_type} control", False),
        ("Control", f"{loop}; {many(attempts, 'attempt')} at an episode at most", False),
        ("Seeds", _seeds(plan.cells), False),
        ("Intervals", _methods(summary), False),
        *(("Machine", _flat(facts), False) for facts in run.machines.values()),
    ]
    return [ProvenanceItem(*pair) for pair in pairs]


def _seeds(cells: Sequence[PlannedCell]) -> str:
    """Return where the seeds come from, and their ranges."""
    frozen = sum(cell.frozen for cell in cells)
    origin = {0: "counted", len(cells): "the environment's evaluation seeds"}.get(frozen, "of both kinds")
    ranges = list(dict.fromkeys(f"{min(cell.seeds)} to {max(cell.seeds)}" for cell in cells))
    more = ", ..." if len(ranges) > _MOST_RANGES else ""
    return f"{origin}: {', '.join(ranges[:_MOST_RANGES])}{more}"


def _methods(summary: Summary) -> str:
    methods = summary.methods
    return f"{wording.percent(summary.confidence)}; success: {methods.success}, score: {methods.score}"


def _flat(value: object) -> str:
    """Return facts on one line."""
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {_flat(one)}" for name, one in value.items())
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)
