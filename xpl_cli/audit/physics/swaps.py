"""Environments with one thing swapped, to test whether a policy does better there."""

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
    from xpl_cli.audit.physics.rollout import LoopEnv

COLOURS, CAMERAS, GRIPPERS = "colours", "cameras", "grippers"
COMMANDS, OBSERVATIONS = "commands", "observations"
_PAIRS = 3
"""Most pairs of cameras that are tried; each costs whole episodes."""
_WRIST = "wrist"


@dataclass(frozen=True)
class EnvSwap:
    """One thing that is swapped in an environment.

    Attributes:
        kind: `COLOURS`: red and blue of all images; `CAMERAS`: the images of two cameras; `GRIPPERS`: open and closed.
        names: the two cameras; for grippers, what is inverted: `COMMANDS`, `OBSERVATIONS` or both.
    """

    kind: str
    names: tuple[str, ...] = ()

    def __str__(self) -> str:
        what = " and ".join(self.names)
        if self.kind == COLOURS:
            return "red and blue of the images are swapped"
        if self.kind == CAMERAS:
            return f"the images of {what} are swapped"
        return f"the {what} of the gripper are inverted"

    @property
    def advice(self) -> str:
        """What to compare if a policy does better with this swap."""
        if self.kind == COLOURS:
            return (
                "compare the order of the channels with the authors' own code; `xpl model-io show` draws what it gets"
            )
        if self.kind == CAMERAS:
            return "compare which camera each input of the model gets with the authors' own code (`xpl model-io show`)"
        what = " and ".join(self.names)
        return f"compare the {what} of the gripper with the authors' own code before you invert anything"

    def unswap(self, observed: np.ndarray, commanded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the real openings and commands of a gripper for those of the swapped environment."""
        both = sdk.GRIPPER_OPEN + sdk.GRIPPER_CLOSED
        real_observed = both - observed if OBSERVATIONS in self.names else observed
        return real_observed, both - commanded if COMMANDS in self.names else commanded

    def apply_to(self, env: LoopEnv, robot: Embodiment) -> SwappedEnv:
        """Return an environment with this swap."""
        return SwappedEnv(env, self, [arm.prefix + sdk.State.EE_JOINT_STATE for arm in robot.arms])


def image_swaps(cameras: Sequence[str]) -> list[EnvSwap]:
    """Return the swaps of images, for the cameras that a policy reads.

    They are tried before grippers: a policy with red and blue swapped may close its gripper instead of opening it.
    """
    pairs = sorted(itertools.combinations(cameras, 2), key=lambda pair: -sum(_WRIST in name for name in pair))
    colours = [EnvSwap(COLOURS)] if cameras else []
    return [*colours, *(EnvSwap(CAMERAS, pair) for pair in pairs[:_PAIRS])]


GRIPPER_SWAPS = tuple(EnvSwap(GRIPPERS, names) for names in ((COMMANDS,), (OBSERVATIONS,), (COMMANDS, OBSERVATIONS)))
"""Every swap of open and closed."""


class SwappedEnv:
    """A task environment with a `Swap`.

    Args:
        env: the real environment.
        swap: what is swapped.
        keys: keys of grippers in states and actions.
    """

    def __init__(self, env: LoopEnv, swap: EnvSwap, keys: Sequence[str]) -> None:
        self._env, self._swap, self._keys = env, swap, tuple(keys)

    def get_running_env_idx_list(self) -> list[int]:
        """Return the indices of environments whose episode is running."""
        return self._env.get_running_env_idx_list()

    def results(self) -> list[Result]:
        """Return the outcome of every environment's episode."""
        return self._env.results()

    def get_obs_batch(self, env_idx_list: Sequence[int]) -> list[ObservationDict]:
        """Return observations of some environments."""
        return [self._swap_observation(obs) for obs in self._env.get_obs_batch(env_idx_list)]

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[Report]:
        """Execute one action step in some environments."""
        swaps_commands = COMMANDS in self._swap.names
        swapped = [self._invert_grippers(action) for action in actions] if swaps_commands else list(actions)
        return self._env.take_action_batch(swapped, env_idx_list)

    def _swap_observation(self, obs: ObservationDict) -> ObservationDict:
        swap = self._swap
        if swap.kind == COLOURS:
            for camera in obs[sdk.Obs.VISION]:
                obs = changed_inputs.red_and_blue_exchanged(obs, f"{sdk.Obs.VISION}.{camera}")
        elif swap.kind == CAMERAS:
            shapes = {np.shape(obs[sdk.Obs.VISION][name][sdk.Camera.COLOR]) for name in swap.names}
            if len(shapes) == 1:  # a model may refuse another size
                obs = changed_inputs.cameras_exchanged(obs, *(f"{sdk.Obs.VISION}.{name}" for name in swap.names))
        elif OBSERVATIONS in swap.names:
            obs = {**obs, sdk.Obs.STATE: self._invert_grippers(obs[sdk.Obs.STATE])}
        return obs

    def _invert_grippers(self, values: State) -> State:
        inverted = {
            key: np.float32(sdk.GRIPPER_OPEN + sdk.GRIPPER_CLOSED) - np.asarray(values[key]) for key in self._keys
        }
        return {**values, **inverted}
