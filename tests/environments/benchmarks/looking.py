"""Shared parts of programs in a benchmark's own Python: they make its environment, move an arm and observe."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT))

from xpl import rotation  # noqa: E402 - this Python has no xpl but the checkout's
from xpl.process.modules import load_module  # noqa: E402 - likewise

STEPS = 40


def make(name: str, **config: Any) -> Any:
    """Return an environment package's environment, in this process, with its poses commanded."""
    defaults = {"action_type": "ee", "cameras": False, "privileged": True}
    return load_module(ROOT / "envs" / name / "client.py").make({**defaults, **config})


def command(obs: Mapping[str, Any], moved: Any = (0, 0, 0), opening: float | None = None) -> dict[str, Any]:
    """Return the action that moves the flange of an observation; its gripper stays, or goes to an opening."""
    state = obs["state"]
    pose = state["ee_pose"].copy()
    pose[:3] += np.asarray(moved, dtype=np.float32)
    fingers = state["ee_joint_state"] if opening is None else np.array([opening], dtype=np.float32)
    return {"ee_pose": pose, "ee_joint_state": fingers}


def travelled(env: Any, moved: Any, opening: float = 1.0, seed: int = 0, steps: int = STEPS) -> list[float]:
    """Return how far the point between the fingers went, m, while the flange was sent somewhere."""
    env.reset([seed])
    first = env.get_obs()
    action = command(first, moved, opening)
    for _ in range(steps):
        env.take_action(action)
    return (env.get_obs()["state"]["tcp_pose"] - first["state"]["tcp_pose"])[:3].tolist()


def along_axes(env: Any, far: float, **more: Any) -> dict[str, list[float]]:
    """Return where the tool went for a command along each axis, both ways."""
    named = {f"{sign}{axis}": (-far if sign == "-" else far) * np.eye(3)["xyz".index(axis)] for sign, axis in _WAYS}
    return {way: travelled(env, moved, **more) for way, moved in named.items()}


_WAYS = [(sign, axis) for axis in "xyz" for sign in "+-"]


def turns(env: Any, steps: int = STEPS) -> list[list[float]]:
    """Return, for each axis of the world, the rotation vector of the tool after a command of 0.3 rad."""
    rotations = []
    for axis in np.eye(3):
        env.reset([0])
        first = env.get_obs()
        action, before = command(first), first["state"]["tcp_pose"][3:]
        action["ee_pose"][3:] = rotation.multiply(rotation.from_axis_angle(0.3 * axis), action["ee_pose"][3:])
        for _ in range(steps):
            env.take_action(action)
        after = env.get_obs()["state"]["tcp_pose"][3:]
        rotations.append(rotation.to_axis_angle(rotation.multiply(after, rotation.conjugate(before))).tolist())
    return rotations


def guessed(env: Any, episodes: int, max_steps: int) -> int:
    """Return how many episodes of random poses succeed."""
    rng, solved = np.random.default_rng(1), 0
    for seed in range(episodes):
        env.reset([seed], {"max_steps": max_steps})
        while not env.is_episode_end():
            env.take_action(command(env.get_obs(), rng.uniform(-0.05, 0.05, 3), float(rng.uniform())))
        solved += env.results()[0]["success"]
    return solved


def openings(env: Any, steps: int = STEPS) -> list[float]:
    """Return the opening of the gripper after it was closed, and after it was opened again."""
    env.reset([0])
    values = []
    for opening in (0.0, 1.0):
        action = command(env.get_obs(), opening=opening)
        for _ in range(steps):
            env.take_action(action)
        values.append(float(env.get_obs()["state"]["ee_joint_state"][0]))
    return values


def projected(camera: Mapping[str, Any], point: Any) -> tuple[float, float]:
    """Return column and row of a point of the world in a picture."""
    camera_point = np.asarray(camera["extrinsics_matrix"]) @ np.append(np.asarray(point, dtype=np.float64), 1.0)
    column, row, depth = np.asarray(camera["intrinsic_matrix"]) @ camera_point[:3]
    return float(column / depth), float(row / depth)


def colored(picture: np.ndarray, pixel: tuple[float, float], reach: int = 1) -> list[float]:
    """Return the mean color around a place of a picture."""
    column, row = (round(value - 0.5) for value in pixel)
    around = picture[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    return around.reshape(-1, 3).mean(axis=0).tolist()


def told(env: Any) -> np.ndarray:
    """Return the last command of the simulator of the only environment."""
    return np.asarray(env.simulated().command, dtype=np.float64)


def played(env: Any, state: Callable[[Any], np.ndarray], steps: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Run random poses in episode 3; return the simulator's commands, and its states before and after each."""
    env.reset([3])
    rng, commands, states = np.random.default_rng(0), [], [state(env)]
    for _ in range(steps):
        env.take_action(command(env.get_obs(), rng.uniform(-0.05, 0.05, 3), opening=float(rng.uniform())))
        commands.append(told(env))
        states.append(state(env))
    return commands, states


def different(states: list[np.ndarray], again: list[np.ndarray]) -> int:
    """Return how many of two lists of states differ at all."""
    return sum(bool((one != other).any()) for one, other in zip(states, again, strict=True))


def changes(env: Any, moved: Any, steps: int = 5) -> list[list[float]]:
    """Add a delta to the command in each step, from the first observation on; return the simulator's commands."""
    env.reset([0])
    action, commands = command(env.get_obs(), opening=0.25), []
    for _ in range(steps):
        action["ee_pose"] = action["ee_pose"] + np.append(np.asarray(moved), np.zeros(4)).astype(np.float32)
        env.take_action(action)
        commands.append(told(env).tolist())
    return commands


def listed(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays as JSON has them."""
    return {name: np.asarray(value).tolist() for name, value in state.items()}


def show(parts: Mapping[str, Callable[[], Any]]) -> None:
    """Print the parts that the command line names, as JSON; simulators print, too."""
    with contextlib.redirect_stdout(io.StringIO()):
        results = {name: parts[name]() for name in sys.argv[1:]}
    print(json.dumps(results))  # noqa: T201
