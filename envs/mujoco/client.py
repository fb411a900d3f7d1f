"""The environment client: `make(config)` gives the TASK_ENV that benchmarks and the audit drive.

Importing this module is cheap; MuJoCo comes in with the first reset.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.environment import EnvironmentBase, one_of

from .manifest import manifest, manifest_for

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from xpl.episode import Setup

    from .episode import Episode

_RENDERER = "renderer"


class MujocoEnv(EnvironmentBase["_Place"]):
    """One or several environments in one process (see `xpl.environment.EnvironmentBase`).

    Limits are kept by `control`, which models the robot's; reports carry its corrections.

    Args:
        config: as for every environment; and renderer, "raycast" (default), which needs no graphics library, or "egl"
            or "osmesa", for looks.

    Raises:
        ValueError: a value is missing, unknown or not offered.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        facts, rest = manifest(), dict(config)
        self._renderer = rest.pop(_RENDERER, facts.renderers[0])
        one_of(_RENDERER, self._renderer, facts.renderers)
        super().__init__(facts, rest)

    @property
    def episodes(self) -> tuple[Episode, ...]:
        """The episodes of all environments, for tools that look behind the observations; empty before `reset`."""
        return tuple(slot.episode for slot in self._envs)

    def render(self, env_idx: int = 0, camera: str | None = None) -> NDArray[np.uint8]:
        """Return a camera of env.yml, (H, W, 3) uint8 RGB, for people; observations do not change.

        Args:
            env_idx: the environment.
            camera: name; by default the one with the whole robot in view.

        Raises:
            ValueError: there is no such camera.
        """
        episode = self._env(env_idx).episode
        name, entries = camera or spec.OPTIONAL_CAMERAS[0], manifest_for(len(self._setup.embodiment.arms))["cameras"]
        one_of("camera", name, entries)
        return episode.render(name, entries[name]["height"], entries[name]["width"]).color

    def _make_env(self, setup: Setup, index: int) -> _Place:
        return _Place(setup, self._renderer, index)


class _Place:
    """One environment: an episode after the other, each built anew."""

    def __init__(self, setup: Setup, renderer: str, env_idx: int) -> None:
        self._setup, self._renderer, self._env_idx = setup, renderer, env_idx

    def reset(self, seed: int) -> None:
        from .episode import Episode

        self.close()
        self.episode = Episode(self._setup, self._renderer, seed, self._env_idx)

    @property
    def end_reason(self) -> str | None:
        return self.episode.end_reason

    def observe(self) -> dict[str, Any]:
        return self.episode.observe()

    def step(self, action: Mapping[str, Any]) -> dict[str, Any]:
        return self.episode.step(action)

    def result(self) -> dict[str, Any]:
        return self.episode.result()

    def close(self) -> None:
        if hasattr(self, "episode"):
            self.episode.close()


def make(config: Mapping[str, Any]) -> MujocoEnv:
    """Make the environment.

    Args:
        config: see `MujocoEnv`; task and embodiment are required.

    Raises:
        ValueError: a value is missing, unknown or not offered.
    """
    return MujocoEnv(config)
