"""Rollouts in this process by an environment's scripted expert or by random actions; no server, no cameras."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl import get_embodiment, rotation
from xpl_cli.basics import content
from xpl_cli.basics.errors import NotFoundError, UnknownTargetError, UserError, no_such
from xpl_cli.lifecycle import interpreter
from xpl_cli.packages import environments, package

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import ArrayLike

    from xpl.contract import Action, Config, Observation, Result
    from xpl.manifest import EnvManifest, Task

    Player = Callable[[Observation], Action]
    """Answers each observation of an episode."""

_JOINT = sdk.ACTION_TYPES[0]
_MOVED, _TURNED = 0.05, 0.5  # m and rad, along and about each axis: how far random poses lie from the present one
_EXPERT = "expert"
PLAYERS = (_EXPERT, "random")
"""Names of players without a policy: the environment's scripted expert, or random actions."""


@dataclass(frozen=True)
class Scenario:
    """Environment, task and robot of a rollout.

    Attributes:
        environment: name of an environment package, or its folder.
        task: a task of it.
        embodiment: an embodiment of it.
        setting: a setting of it.
        action_type: "joint" or "ee".
        renderer: one of the environment's; its own choice by default.
    """

    environment: str
    task: str
    embodiment: str
    setting: str
    action_type: str = _JOINT
    renderer: str | None = None

    def config(self) -> Config:
        """Return the configuration with which the environment is made."""
        return {
            "task": self.task,
            "embodiment": self.embodiment,
            "setting": self.setting,
            sdk.Deploy.ACTION_TYPE: self.action_type,
            "cameras": False,
            sdk.Obs.PRIVILEGED: True,
            **({} if self.renderer is None else {"renderer": self.renderer}),
        }


def make_scenario(
    name: str, renderer: str | None = None, action_type: str | None = None, **names: str | None
) -> Scenario:
    """Return a scenario of an environment.

    Args:
        name: the package, or its folder.
        renderer: one of the environment's.
        action_type: one of the environment's; its first by default.
        names: task, embodiment and setting; the first that there is by default. Without a wish, the embodiment is the
            first that the task is offered with.

    Raises:
        NotFoundError: there is no environment, task, embodiment, setting, kind of control or renderer of that name.
    """
    facts = environments.manifest(environments.find(name))
    task = choose_name("task", names.get("task"), facts.tasks)
    robots = [robot for robot in facts.embodiments if unsupported(facts.tasks[task], robot) is None]
    robot = names.get("embodiment")
    return Scenario(
        environment=name,
        task=task,
        embodiment=choose_name("embodiment", robot, facts.embodiments) if robot else robots[0],
        setting=choose_name("setting", names.get("setting"), facts.settings),
        action_type=choose_name("kind of control", action_type, facts.action_types),
        renderer=choose_name("renderer", renderer, facts.renderers) if renderer else None,
    )


def choose_name(what: str, requested: str | None, offered: Iterable[str]) -> str:
    """Return the name that is wanted, or the first that is offered.

    Raises:
        UnknownTargetError: it is not offered; with the nearest name, and all of them.
    """
    names = list(offered)
    if requested is None:
        return names[0]
    if requested in names:
        return requested
    raise no_such(f"there is no {what} {requested!r}", requested, names, kind=UnknownTargetError)


def expand_splits(facts: EnvManifest, names: Iterable[str]) -> list[str]:
    """Return names of tasks, each once, with the tasks of a split (`splits` in env.yml) in its name's place."""
    splits = facts.splits
    return list(dict.fromkeys(task for name in names for task in splits.get(name, [name])))


def unsupported(task: Task, embodiment: str) -> str | None:
    """Return why a task is not offered with an embodiment; None if it is."""
    if task.arms and len(get_embodiment(embodiment).arms) not in task.arms:
        return f"for {' or '.join(map(str, task.arms))} arms"
    return task.unsupported.get(embodiment)


def make(scenario: Scenario) -> Any:
    """Return the environment: in this process, or in one with the Python that its manifest declares.

    Raises:
        UserError: the environment does not offer the scenario, may be a robot, or its Python is not installed.
    """
    environments.require_simulation(scenario.environment)
    folder = environments.find(scenario.environment)
    python = interpreter.resolve(folder, environments.manifest(folder).environment)
    if python != sys.executable:
        return environments.start(scenario.environment, scenario.config(), python=python)
    try:
        return environments.make(scenario.environment, scenario.config())
    except (ValueError, LookupError) as error:
        raise UserError(f"{scenario.environment}: {error}") from None


def expert(scenario: Scenario) -> Player:
    """Return a new player of the environment's own expert, which its manifest names.

    Raises:
        NotFoundError: the environment names none.
    """
    name = environments.manifest(environments.find(scenario.environment)).expert
    if name is None:
        raise NotFoundError(
            f"{scenario.environment} names no expert", hint="expert: NAME in env.yml, a policy of policy/"
        )
    module = content.load_module(package.find_policy(name) / sdk.File.MODEL_PY)
    adapter = getattr(module, sdk.MODEL_CLASS)
    policy = adapter({sdk.Deploy.ENV_CFG_TYPE: scenario.embodiment, sdk.Deploy.ACTION_TYPE: scenario.action_type})

    def act(obs: Observation) -> Action:
        policy.update_obs(obs)
        action: Action = policy.get_action()[0]
        return action

    return act


def random_actions(scenario: Scenario, seed: int) -> Player:
    """Return a new player that draws every joint and gripper anew in each step, within its limits.

    Where poses are commanded, they lie up to 5 cm and 0.5 rad from the present one, along and about each axis.
    """
    robot, rng = get_embodiment(scenario.embodiment), np.random.default_rng(seed)
    arm_key, gripper_key = sdk.ACTION_KEYS[scenario.action_type]

    def act(obs: Observation) -> Action:
        action = {}
        for arm in robot.arms:
            if arm_key == sdk.State.EE_POSE:
                action[arm.prefix + arm_key] = _pose_near(obs[sdk.Obs.STATE][arm.prefix + arm_key], rng)
            else:
                low, high = (-math.pi, math.pi) if arm.lower is None or arm.upper is None else (arm.lower, arm.upper)
                action[arm.prefix + arm_key] = rng.uniform(low, high, arm.dof)
            action[arm.prefix + gripper_key] = rng.uniform(sdk.GRIPPER_CLOSED, sdk.GRIPPER_OPEN, arm.ee_dim)
        return action

    return act


def random_control(action_types: Sequence[str]) -> str:
    """Return in which kind of control random actions are drawn: joint angles where an environment takes them."""
    return _JOINT if _JOINT in action_types else action_types[0]


def make_player(name: str, scenario: Scenario, seed: int) -> tuple[Scenario, Player]:
    """Return a new player by its name, one of `PLAYERS`, and its scenario.

    Raises:
        NotFoundError: there is no player of that name, or the environment names no expert.
    """
    if choose_name("player", name, PLAYERS) == _EXPERT:
        return scenario, expert(scenario)
    offered = environments.manifest(environments.find(scenario.environment)).action_types
    scenario = replace(scenario, action_type=random_control(offered))
    return scenario, random_actions(scenario, seed)


def _pose_near(pose: ArrayLike, rng: np.random.Generator) -> np.ndarray:
    """Return a pose (7,) near another one."""
    start = np.asarray(pose, dtype=np.float64)
    turn = rotation.from_axis_angle(rng.uniform(-_TURNED, _TURNED, 3))
    moved = start[: sdk.POSITION_DIM] + rng.uniform(-_MOVED, _MOVED, sdk.POSITION_DIM)
    return np.concatenate([moved, rotation.multiply(turn, start[sdk.POSITION_DIM :])])


def run_episode(env: Any, act: Player, seed: int, watch: Callable[[], None] = lambda: None) -> Result:
    """Run one episode and return its result; `watch` is called before every step and at the end."""
    env.reset([seed])
    while not env.is_episode_end():
        watch()
        env.take_action(act(env.get_obs()))
    watch()
    result: Result = env.results()[0]
    return result
