"""One environment of another project, on its task nearest to ours: run by its own interpreter, prints a JSON object.

`step_ms` is a control step with the environment's own observation but no image, `raw_ms` the same number of physics
steps by `mj_step` alone in the same state, `picture_ms` the camera of its observations.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from clock import alternate, wall  # the interpreter knows no `benchmarks`

Figures = dict[str, Any]


def gym_aloha() -> Figures:
    """Transfer a cube between two arms; observations have one camera."""
    import gym_aloha  # noqa: F401 - registers the environments
    import gymnasium
    import mujoco

    env = gymnasium.make("gym_aloha/AlohaTransferCube-v0", obs_type="pixels_agent_pos", disable_env_checker=True)
    env.reset(seed=0)
    inner = env.unwrapped._env  # noqa: SLF001 - dm_control's environment, which can be stepped without a picture
    physics = inner.physics
    model, data = physics.model.ptr, physics.data.ptr
    period = inner.control_timestep()
    count = round(period / physics.timestep())
    hold = np.zeros(env.action_space.shape, dtype=np.float32)
    picture = wall({"one": lambda: physics.render(height=480, width=640, camera_id="top")}, 1, rounds=7)
    physics.render = lambda *_, **__: np.zeros((480, 640, 3), dtype=np.uint8)
    inner.reset()
    times = alternate({"step": lambda: inner.step(hold), "raw": lambda: mujoco.mj_step(model, data, count)}, 2)
    figures = _figures("AlohaTransferCube", period, count, times, inner.reset)
    return {**figures, "pictures": "480x640", "picture_ms": picture["one"]}


def gymnasium_robotics() -> Figures:
    """Pick and place with one arm; observations have no camera."""
    import gymnasium
    import gymnasium_robotics
    import mujoco

    gymnasium.register_envs(gymnasium_robotics)
    env = gymnasium.make("FetchPickAndPlace-v4", max_episode_steps=10**9, disable_env_checker=True)
    env.reset(seed=0)
    inner = env.unwrapped
    hold = np.zeros(env.action_space.shape, dtype=np.float32)
    count = inner.n_substeps
    times = alternate(
        {"step": lambda: env.step(hold), "raw": lambda: mujoco.mj_step(inner.model, inner.data, count)}, 5
    )
    return _figures("FetchPickAndPlace", count * inner.model.opt.timestep, count, times, env.reset)


def robosuite() -> Figures:
    """Lift a cube with one arm; without its camera observations."""
    import mujoco
    import robosuite as suite

    env = suite.make(
        "Lift",
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        control_freq=20,
        horizon=10**9,
    )
    env.reset()
    hold = np.zeros(env.action_dim)
    count = round(env.control_timestep / env.model_timestep)
    model, data = env.sim.model._model, env.sim.data._data  # noqa: SLF001 - MuJoCo's own, which it wraps
    times = alternate({"step": lambda: env.step(hold), "raw": lambda: mujoco.mj_step(model, data, count)}, 1, rounds=31)
    return _figures("Lift", env.control_timestep, count, times, env.reset)


def _figures(task: str, period: float, count: int, times: dict[str, float], reset: Callable[[], object]) -> Figures:
    return {
        "task": task,
        "hz": round(1.0 / period),
        "physics_steps": count,
        "step_ms": times["step"],
        "raw_ms": times["raw"],
        "pictures": None,
        "picture_ms": None,
        "reset_ms": alternate({"reset": reset}, 1, rounds=3)["reset"],
    }


PEERS = {"gym-aloha": gym_aloha, "gymnasium-robotics": gymnasium_robotics, "robosuite": robosuite}

if __name__ == "__main__":
    print(json.dumps(PEERS[sys.argv[1]]()))
