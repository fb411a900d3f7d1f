"""Environments in which one thing is exchanged, to see whether a policy fares better where it is."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk
from xpl_cli.audit.served import changed_inputs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Action, ObservationDict, Report, Result, State
    from xpl.embodiment import Embodiment
    from xpl_cli.audit.physics.loop import Playing

COLOURS, CAMERAS, GRIPPERS = "colours", "cameras", "grippers"
COMMANDS, OBSERVATIONS = "commands", "observations"
_PAIRS = 3
"""Pairs of cameras that are tried at most; each costs whole episodes."""
_WRIST = "wrist"


@dataclass(frozen=True)
class World:
    """An environment in which one thing is exchanged.

    Attributes:
        kind: `COLOURS`: red and blue of all pictures; `CAMERAS`: the pictures of two cameras; `GRIPPERS`: open and
            closed.
        names: the two cameras; of grippers, what is exchanged: `COMMANDS`, `OBSERVATIONS` or both.
    """

    kind: str
    names: tuple[str, ...] = ()

    def __str__(self) -> str:
        what = " and ".join(self.names)
        if self.kind == COLOURS:
            return "red and blue of the pictures are exchanged"
        if self.kind == CAMERAS:
            return f"the pictures of {what} are exchanged"
        return f"the {what} of the gripper run the other way round"

    @property
    def advice(self) -> str:
        """What to look at where a policy fares better in this world."""
        if self.kind == COLOURS:
            return (
                "compare the order of the channels with the authors' own code; `xpl model-io show` draws what it gets"
            )
        if self.kind == CAMERAS:
            return "compare which camera each input of the model gets with the authors' own code (`xpl model-io show`)"
        what = " and ".join(self.names)
        return f"compare the {what} of the gripper with the authors' own code before anything is turned round"

    def real(self, observed: np.ndarray, commanded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where a gripper was and went to, of what a policy saw and said in this world."""
        both = sdk.GRIPPER_OPEN + sdk.GRIPPER_CLOSED
        seen = both - observed if OBSERVATIONS in self.names else observed
        return seen, both - commanded if COMMANDS in self.names else commanded

    def around(self, env: Playing, robot: Embodiment) -> Mirror:
        """Return the environment as it is in this world."""
        return Mirror(env, self, [arm.prefix + sdk.State.EE_JOINT_STATE for arm in robot.arms])


def pictured(cameras: Sequence[str]) -> list[World]:
    """Return the worlds in which something of the pictures is exchanged, of the cameras that a policy reads.

    They come before grippers: a policy that sees red for blue may well close its gripper where it should open it.
    """
    pairs = sorted(itertools.combinations(cameras, 2), key=lambda pair: -sum(_WRIST in name for name in pair))
    colours = [World(COLOURS)] if cameras else []
    return [*colours, *(World(CAMERAS, pair) for pair in pairs[:_PAIRS])]


GRIPPERS_TURNED = tuple(World(GRIPPERS, names) for names in ((COMMANDS,), (OBSERVATIONS,), (COMMANDS, OBSERVATIONS)))
"""Every way in which open and closed may be exchanged."""


class Mirror:
    """A task environment as it is in a `World`.

    Args:
        env: the real one.
        world: what is different.
        keys: grippers, as states and actions call them.
    """

    def __init__(self, env: Playing, world: World, keys: Sequence[str]) -> None:
        self._env, self._world, self._keys = env, world, tuple(keys)

    def get_running_env_idx_list(self) -> list[int]:
        """Return the environments whose episode goes on."""
        return self._env.get_running_env_idx_list()

    def results(self) -> list[Result]:
        """Return the outcome of every environment's episode."""
        return self._env.results()

    def get_obs_batch(self, env_idx_list: Sequence[int]) -> list[ObservationDict]:
        """Return observations of some environments."""
        return [self._seen(obs) for obs in self._env.get_obs_batch(env_idx_list)]

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[Report]:
        """Execute one action step in some environments."""
        is_turned = COMMANDS in self._world.names
        turned = [self._turned(action) for action in actions] if is_turned else list(actions)
        return self._env.take_action_batch(turned, env_idx_list)

    def _seen(self, obs: ObservationDict) -> ObservationDict:
        world = self._world
        if world.kind == COLOURS:
            for camera in obs[sdk.Obs.VISION]:
                obs = changed_inputs.red_and_blue_exchanged(obs, f"{sdk.Obs.VISION}.{camera}")
        elif world.kind == CAMERAS:
            shapes = {np.shape(obs[sdk.Obs.VISION][name][sdk.Camera.COLOR]) for name in world.names}
            if len(shapes) == 1:  # a model may well refuse another size
                obs = changed_inputs.cameras_exchanged(obs, *(f"{sdk.Obs.VISION}.{name}" for name in world.names))
        elif OBSERVATIONS in world.names:
            obs = {**obs, sdk.Obs.STATE: self._turned(obs[sdk.Obs.STATE])}
        return obs

    def _turned(self, values: State) -> State:
        swung = {key: np.float32(sdk.GRIPPER_OPEN + sdk.GRIPPER_CLOSED) - np.asarray(values[key]) for key in self._keys}
        return {**values, **swung}
