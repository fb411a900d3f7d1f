"""Success rates over whole episodes: what a manifest claims, and what is measured to see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.figures import ENVIRONMENT, Course, Figure

if TYPE_CHECKING:
    from xpl_cli.audit.physics.mirrors import World
    from xpl_cli.audit.physics.simulation import Simulation

CLAIMED_EPISODES, USUAL_EPISODES = 20, 3
"""Episodes that are played for a claim that names no number, and where nothing is claimed."""


@dataclass(frozen=True)
class Claim:
    """A success rate that a manifest claims.

    Attributes:
        course: in what.
        success_rate: how much, 0..1.
        episodes: how many episodes are played to see.
    """

    course: Course
    success_rate: float
    episodes: int


def claims(simulation: Simulation) -> list[Claim]:
    """Return what the manifest claims about this environment; what it leaves open is that of the first course."""
    first, asked = simulation.first, simulation.probe.options.episodes
    return [
        Claim(
            Course(
                entry.task,
                entry.embodiment or first.embodiment,
                entry.action_type or first.action_type,
                entry.setting,
            ),
            entry.success_rate,
            asked or entry.episodes or CLAIMED_EPISODES,
        )
        for entry in simulation.probe.package.manifest.claims
        if entry.environment == ENVIRONMENT
    ]


def measure(simulation: Simulation, course: Course, episodes: int) -> Figure:
    """Play whole episodes on the task's frozen seeds, as many as there are, and note the figure for the report.

    Raises:
        NotRun: if an episode breaks off, or the task has no such seeds.
    """
    figure = _figure(simulation, course, episodes, None)
    if figure not in simulation.figures:
        simulation.figures.append(figure)
    return figure


def measure_mirrored(simulation: Simulation, course: Course, episodes: int, world: World) -> Figure:
    """Play the same in an environment in which one thing is exchanged; the report is about the real one.

    Raises:
        NotRun: if an episode breaks off, or the task has no such seeds.
    """
    return _figure(simulation, course, episodes, world)


def _figure(simulation: Simulation, course: Course, episodes: int, world: World | None) -> Figure:
    results = simulation.episodes(course, simulation.seeds(course, episodes), world)
    scores = [result.score for result in results]
    return Figure(course, len(results), sum(result.success for result in results), sum(scores) / len(scores))
