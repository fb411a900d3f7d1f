"""Episodes in this process, played by an environment's own expert or by random actions; no server, no cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl import get_embodiment
from xpl_cli import content, environments, package
from xpl_cli.errors import NotFoundError, UserError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_JOINT = sdk.ACTION_TYPES[0]


@dataclass(frozen=True)
class Scenario:
    """What is played.

    Attributes:
        environment: name of an environment package, or its folder.
        task: a task of it.
        embodiment: an embodiment of it.
        setting: a setting of it.
        action_type: "joint" or "ee".
    """

    environment: str
    task: str
    embodiment: str
    setting: str
    action_type: str = _JOINT

    def config(self) -> dict[str, Any]:
        """Return the configuration with which the environment is made."""
        return {
            "task": self.task,
            "embodiment": self.embodiment,
            "setting": self.setting,
            sdk.Deploy.ACTION_TYPE: self.action_type,
            "cameras": False,
            sdk.Obs.PRIVILEGED: True,
        }


def scenario(
    name: str, task: str | None, embodiment: str | None, setting: str | None, action_type: str = _JOINT
) -> Scenario:
    """Return a scenario, the environment's first task, embodiment and setting by default."""
    facts = environments.manifest(environments.find(name))
    return Scenario(
        environment=name,
        task=task or next(iter(facts["tasks"])),
        embodiment=embodiment or facts["embodiments"][0],
        setting=setting or facts["settings"][0],
        action_type=action_type,
    )


def make(what: Scenario) -> Any:
    """Return the environment.

    Raises:
        UserError: the environment does not offer the scenario.
    """
    try:
        return environments.make(what.environment, what.config())
    except (ValueError, LookupError) as error:
        raise UserError(f"{what.environment}: {error}") from None


def expert(what: Scenario) -> Callable[[Mapping[str, Any]], Mapping[str, Any]]:
    """Return a new player of the environment's own expert, which its manifest names.

    Raises:
        NotFoundError: the environment names none.
    """
    name = environments.manifest(environments.find(what.environment)).get("expert")
    if name is None:
        raise NotFoundError(f"{what.environment} names no expert", hint="expert: NAME in env.yml, a policy of policy/")
    module = content.load_module(package.find_policy(name) / sdk.File.MODEL_PY)
    adapter = getattr(module, sdk.MODEL_CLASS)
    policy = adapter({sdk.Deploy.ENV_CFG_TYPE: what.embodiment, sdk.Deploy.ACTION_TYPE: what.action_type})

    def act(obs: Mapping[str, Any]) -> Mapping[str, Any]:
        policy.update_obs(obs)
        action: Mapping[str, Any] = policy.get_action()[0]
        return action

    return act


def at_random(what: Scenario, seed: int) -> Callable[[Mapping[str, Any]], Mapping[str, Any]]:
    """Return a new player that draws every joint and gripper anew in each step, within its limits."""
    robot, rng = get_embodiment(what.embodiment), np.random.default_rng(seed)
    arm_key, gripper_key = sdk.ACTION_KEYS[_JOINT]

    def act(_obs: Mapping[str, Any]) -> Mapping[str, Any]:
        action = {}
        for arm in robot.arms:
            low, high = (-math.pi, math.pi) if arm.lower is None or arm.upper is None else (arm.lower, arm.upper)
            action[arm.prefix + arm_key] = rng.uniform(low, high, arm.dof)
            action[arm.prefix + gripper_key] = rng.uniform(sdk.GRIPPER_CLOSED, sdk.GRIPPER_OPEN, arm.ee_dim)
        return action

    return act


def play(
    env: Any, act: Callable[[Mapping[str, Any]], Mapping[str, Any]], seed: int, watch: Callable[[], None] | None = None
) -> dict[str, Any]:
    """Play one episode and return its result; `watch` is called before every step and at the end."""
    env.reset([seed])
    while not env.is_episode_end():
        if watch is not None:
            watch()
        env.take_action(act(env.get_obs()))
    if watch is not None:
        watch()
    result: dict[str, Any] = env.results()[0]
    return result
