"""Our environment's figures, with the same meaning as a peer's, and what the targets need besides."""

from __future__ import annotations

import copy
import json
import sys
from typing import Any

import mujoco
import numpy as np

from benchmarks.environments_bench.clock import alternate, wall
from xpl import get_embodiment
from xpl_cli.basics.content import content_folder, load_module

ROBOT = "arx_x5"
RAYCAST = "raycast"
SIZES = ((224, 224), (480, 640))
SEED = 0


def tasks() -> list[str]:
    """Return the names of all tasks that support two arms."""
    facts = load_module(content_folder("envs") / "mujoco" / "manifest.py").manifest().data
    return [name for name, entry in facts["tasks"].items() if 2 in entry["arms"]]


def physics(task: str, action_type: str, rounds: int) -> dict[str, float]:
    """Measure the expert's whole episode in a replay.

    Returns:
        `act_ms`, a control step (action, limits, physics, digest, judge), and `raw_ms`, as many physics steps by
        `mj_step` alone, in the same states with the same controls.

    Raises:
        RuntimeError: the task does something that `mj_step` does not.
    """
    episode = _replay(task, action_type)
    times = alternate({"act": episode.play, "raw": episode.play_raw}, 1, rounds=rounds, before=episode.rewind)
    return {f"{name}_ms": taken / len(episode.actions) for name, taken in times.items()}


def check(task: str, action_type: str) -> int:
    """Replay the expert's episode by `mj_step` alone and return its control steps; raises as `physics` does."""
    episode = _replay(task, action_type)
    episode.play_raw()
    return len(episode.actions)


def _replay(task: str, action_type: str) -> _Replay:
    env = _make(task, action_type, cameras=False)
    return _Replay(env, _experts_actions(task, action_type))


def figures(task: str, action_type: str, rounds: int) -> dict[str, Any]:
    """Measure one task with commands that hold the pose, as a peer is measured."""
    env = _make(task, action_type, cameras=False)
    obs = env.get_obs()
    hold = {key: obs["state"][key] for key in get_embodiment(ROBOT).dims(action_type)}
    scene = env.episodes[0].physics
    hertz = round(obs["additional_info"]["frequency"])
    count = round(1.0 / (hertz * scene.model.opt.timestep))
    times = alternate(
        {
            "act": lambda: env.take_action(hold),
            "raw": lambda: mujoco.mj_step(scene.model, scene.data, count),
            "look": env.get_obs,
        },
        10,
        rounds,
    )
    return {
        "task": f"{task}, {ROBOT}, {action_type}",
        "hz": hertz,
        "physics_steps": count,
        "step_ms": times["act"] + times["look"],
        "raw_ms": times["raw"],
        "reset_ms": alternate({"reset": lambda: env.reset([SEED])}, 1, rounds=3)["reset"],
    }


class _Replay:
    """One episode, replayed repeatedly: by the environment, and by `mj_step` alone.

    Args:
        env: of the episode, at its beginning.
        actions: of every control step.
    """

    def __init__(self, env: Any, actions: list[dict[str, Any]]) -> None:
        self._env, self.actions = env, actions
        scene = env.episodes[0].physics
        self._model, data = scene.model, scene.data
        period = 1.0 / env.get_obs()["additional_info"]["frequency"]
        self._count = round(period / self._model.opt.timestep)
        self._start, self._raw = copy.copy(data), copy.copy(data)
        self._controls = []
        for action in actions:
            env.take_action(action)
            self._controls.append(np.array(data.ctrl))
        self._end = np.array(data.qpos)

    def rewind(self) -> None:
        """Go back to the beginning."""
        self._env.reset([SEED])
        mujoco.mj_copyData(self._raw, self._model, self._start)

    def play(self) -> None:
        """Run the episode."""
        for action in self.actions:
            self._env.take_action(action)

    def play_raw(self) -> None:
        """Let MuJoCo alone do what the episode does."""
        model, data, count = self._model, self._raw, self._count
        for control in self._controls:
            data.ctrl[:] = control
            mujoco.mj_step(model, data, count)
        if not np.array_equal(data.qpos, self._end):
            raise RuntimeError("mj_step alone ends elsewhere: the world acts by itself in this task")


def pictures(task: str, size: tuple[int, int], renderer: str, rounds: int) -> float:
    """Return the milliseconds for the pictures of all cameras of one observation.

    Raises:
        RuntimeError: this machine lacks what the renderer needs.
    """
    env = _make(task, "joint", cameras=list(size), renderer=renderer)
    episode = env.episodes[0]

    def look() -> None:
        for camera in episode.cameras.values():
            camera.render(episode.physics.data)

    measure = alternate if renderer == RAYCAST else wall
    taken = measure({"look": look}, 1, rounds)["look"]
    env.close()
    return taken


def _experts_actions(task: str, action_type: str) -> list[dict[str, Any]]:
    """Return the actions with which the expert solves the task."""
    env = _make(task, action_type, cameras=False, privileged=True)
    expert = load_module(content_folder("policy") / "scripted_expert" / "model.py").Model(
        {"env_cfg_type": ROBOT, "action_type": action_type}
    )
    actions: list[dict[str, Any]] = []
    while not env.is_episode_end():
        expert.update_obs(env.get_obs())
        actions.append(expert.get_action()[0])
        env.take_action(actions[-1])
    return actions


def _make(task: str, action_type: str, **config: Any) -> Any:
    make = load_module(content_folder("envs") / "mujoco" / "client.py").make
    settings = {"task": task, "embodiment": ROBOT, "action_type": action_type, "max_steps": 10**9}
    env = make({**settings, **config})
    env.reset([SEED])
    return env


if __name__ == "__main__":  # a process has one OpenGL library, so each has a process of its own
    height, width, count = map(int, sys.argv[3:])
    print(json.dumps({"ms": pictures(sys.argv[1], (height, width), sys.argv[2], count)}))
