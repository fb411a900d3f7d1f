"""Environments whose grippers run the other way round, to see whether a policy has open and closed exchanged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.embodiment import Embodiment


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
