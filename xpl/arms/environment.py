"""The environment of one real robot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Callable

from xpl import _spec as spec
from xpl.environment import Environment
from xpl.episode import EpisodeRunner

if TYPE_CHECKING:
    from xpl.arms.episode import ArmEpisode
    from xpl.contract import Config, Result
    from xpl.episode import Setup
    from xpl.manifest import EnvManifest


class ArmEnvironment(Environment):
    """The one environment of a robot: evaluation puts its guard in front, which knows how old actions are.

    Args:
        episode: makes what plays it, for example a subclass of `xpl.arms.episode.ArmEpisode`.
        manifest: env.yml.
        config: see `xpl.environment.EnvironmentBase`; `num_envs` is 1.

    Raises:
        ValueError: a value is missing, unknown or not offered, or there are to be several.
    """

    guarded = False
    _episodes: list[ArmEpisode]

    def __init__(self, episode: Callable[[Setup], ArmEpisode], manifest: EnvManifest, config: Config) -> None:
        if int(config.get("num_envs") or 1) != 1:
            raise ValueError(f"there is one robot, and num_envs is {config['num_envs']}: ask for 1")
        self._made = episode
        super().__init__(episode, manifest, config)

    def results(self) -> list[Result]:
        """Return the outcome of the robot's episode, with the trial that it was."""
        return [
            {**result, "layout": place.trial(result[spec.Deploy.SEED])}
            for place, result in zip(self._episodes, super().results())
        ]

    def _make_env(self, setup: Setup, index: int) -> EpisodeRunner:
        made = self._made(setup)
        self._episodes = [made]
        return EpisodeRunner(made, index)
