"""Success rates and scores over whole episodes: what a manifest claims, what was measured, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl_cli.audit.physics.loop import Course
from xpl_cli.audit.physics.simulation import ENVIRONMENT
from xpl_cli.evaluation.statistics.intervals import Interval, wilson

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.embodiment import Embodiment
    from xpl_cli.audit.physics.simulation import Simulation

CLAIMED_EPISODES, USUAL_EPISODES = 20, 3
"""Episodes that are played for a claim that names no number, and where nothing is claimed."""


@dataclass(frozen=True)
class Figure:
    """What was measured.

    Attributes:
        course: what was driven.
        episodes: how many episodes.
        successes: how many of them succeeded.
        mean_score: mean of their scores, 0..1.
    """

    course: Course
    episodes: int
    successes: int
    mean_score: float

    @property
    def success_rate(self) -> float:
        """Share of the episodes that succeeded."""
        return self.successes / self.episodes

    @property
    def success_interval(self) -> Interval:
        """Where the success rate lies, with 95 % confidence."""
        return wilson(self.success_rate, self.episodes)

    @property
    def score_interval(self) -> Interval:
        """Where the mean score lies, with 95 % confidence or more."""
        return wilson(self.mean_score, self.episodes)

    def __str__(self) -> str:
        return (
            f"{self.course}: {self.successes} of {self.episodes} episodes succeed ({self.success_interval}), "
            f"mean score {self.mean_score:.2f} ({self.score_interval.low:.2f} to {self.score_interval.high:.2f})"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the figure as a map of plain values."""
        course = self.course
        return {
            "environment": ENVIRONMENT,
            "task": course.task,
            "embodiment": course.embodiment,
            sdk.Deploy.ACTION_TYPE: course.action_type,
            "setting": course.setting,
            "episodes": self.episodes,
            "successes": self.successes,
            "success_rate": self.success_rate,
            "success_interval": list(self.success_interval),
            "mean_score": self.mean_score,
            "score_interval": list(self.score_interval),
        }


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


@dataclass(frozen=True)
class World:
    """An environment whose grippers run the other way round.

    Attributes:
        commands: 0 opens and 1 closes.
        observations: 0 is seen as open and 1 as closed.
    """

    commands: bool
    observations: bool

    def __str__(self) -> str:
        parts = [name for name, is_other in vars(self).items() if is_other]
        return " and ".join(parts)

    def around(self, env: Any, robot: Embodiment) -> Mirror:
        """Return the environment as it is in this world."""
        return Mirror(env, self, [arm.prefix + sdk.State.EE_JOINT_STATE for arm in robot.arms])


MIRRORED = (World(commands=True, observations=False), World(commands=False, observations=True), World(True, True))  # noqa: FBT003 - as named before
"""Every way in which a policy may have open and closed exchanged."""


class Mirror:
    """A task environment with the grippers of a `World`.

    Args:
        env: the real one.
        world: what is different.
        keys: grippers, as states and actions call them.
    """

    def __init__(self, env: Any, world: World, keys: Sequence[str]) -> None:
        self._env, self._world, self._keys = env, world, tuple(keys)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def get_obs_batch(self, env_idx_list: Sequence[int]) -> list[dict[str, Any]]:
        """Return observations of some environments."""
        found: list[dict[str, Any]] = self._env.get_obs_batch(env_idx_list)
        if self._world.observations:
            found = [{**obs, sdk.Obs.STATE: self._turned(obs[sdk.Obs.STATE])} for obs in found]
        return found

    def take_action_batch(self, actions: Sequence[Mapping[str, Any]], env_idx_list: Sequence[int]) -> Any:
        """Execute one action step in some environments."""
        turned = [self._turned(action) for action in actions] if self._world.commands else list(actions)
        return self._env.take_action_batch(turned, env_idx_list)

    def _turned(self, values: Mapping[str, Any]) -> dict[str, Any]:
        swung = {key: np.float32(sdk.GRIPPER_OPEN + sdk.GRIPPER_CLOSED) - np.asarray(values[key]) for key in self._keys}
        return {**values, **swung}


def claims(simulation: Simulation) -> list[Claim]:
    """Return what the manifest claims about this environment; what it leaves open is that of the first course."""
    first, asked = simulation.first, simulation.probe.options.episodes
    return [
        Claim(
            Course(
                entry["task"],
                entry.get("embodiment", first.embodiment),
                entry.get(sdk.Deploy.ACTION_TYPE, first.action_type),
                entry.get("setting"),
            ),
            float(entry["success_rate"]),
            asked or entry.get("episodes") or CLAIMED_EPISODES,
        )
        for entry in simulation.probe.package.manifest.get("claims") or ()
        if entry["environment"] == ENVIRONMENT
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
    """Play the same in an environment whose grippers run the other way round; the report is about the real one.

    Raises:
        NotRun: if an episode breaks off, or the task has no such seeds.
    """
    return _figure(simulation, course, episodes, world)


def _figure(simulation: Simulation, course: Course, episodes: int, world: World | None) -> Figure:
    results = simulation.episodes(course, simulation.seeds(course, episodes), world)
    scores = [float(result["score"]) for result in results]
    return Figure(course, len(results), sum(bool(result["success"]) for result in results), sum(scores) / len(scores))
