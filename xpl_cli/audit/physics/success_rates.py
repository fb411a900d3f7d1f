"""Success rates over whole episodes: the manifest's claims, and measurements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.measurements import ENVIRONMENT, RolloutSetup, SuccessMeasurement

if TYPE_CHECKING:
    from xpl_cli.audit.physics.simulation import Simulation
    from xpl_cli.audit.physics.swaps import EnvSwap

CLAIMED_EPISODES, USUAL_EPISODES = 20, 3
"""Number of episodes for a claim without one, and without a claim."""


@dataclass(frozen=True)
class ClaimedRate:
    """A success rate that the manifest claims.

    Attributes:
        setup: task, robot and setting.
        success_rate: the claimed rate, 0..1.
        episodes: number of episodes to measure it.
    """

    setup: RolloutSetup
    success_rate: float
    episodes: int


def claimed_rates(simulation: Simulation) -> list[ClaimedRate]:
    """Return the manifest's claims for this environment; missing values are those of the first setup."""
    first, requested_episodes = simulation.first, simulation.probe.options.episodes
    return [
        ClaimedRate(
            RolloutSetup(
                entry.task,
                entry.embodiment or first.embodiment,
                entry.action_type or first.action_type,
                entry.setting,
            ),
            entry.success_rate,
            requested_episodes or entry.episodes or CLAIMED_EPISODES,
        )
        for entry in simulation.probe.package.manifest.claims
        if entry.environment == ENVIRONMENT
    ]


def measure(simulation: Simulation, setup: RolloutSetup, episodes: int) -> SuccessMeasurement:
    """Run whole episodes on the task's fixed seeds, as many as there are, and add the measurement to the report.

    Raises:
        NotRun: if an episode breaks off, or the task has no such seeds.
    """
    measurement = _run_and_measure(simulation, setup, episodes, None)
    if measurement not in simulation.measurements:
        simulation.measurements.append(measurement)
    return measurement


def measure_swapped(simulation: Simulation, setup: RolloutSetup, episodes: int, swap: EnvSwap) -> SuccessMeasurement:
    """Run the same in an environment with one thing swapped; it is not added to the report.

    Raises:
        NotRun: if an episode breaks off, or the task has no such seeds.
    """
    return _run_and_measure(simulation, setup, episodes, swap)


def _run_and_measure(
    simulation: Simulation, setup: RolloutSetup, episodes: int, swap: EnvSwap | None
) -> SuccessMeasurement:
    results = simulation.run_episodes(setup, simulation.seeds(setup, episodes), swap)
    scores = [result.score for result in results]
    return SuccessMeasurement(setup, len(results), sum(result.success for result in results), sum(scores) / len(scores))
