"""Our environment's figures, with the same meaning as a peer's, and what the targets need besides."""

from __future__ import annotations

from typing import Any

import mujoco

from benchmarks.environments_bench.clock import alternate, wall
from xpl import get_embodiment
from xpl_cli.content import load_module, room

ROBOT = "arx_x5"
RAYCAST = "raycast"
SIZES = ((224, 224), (480, 640))


def figures(task: str, action_type: str, embodiment: str = ROBOT) -> dict[str, Any]:
    """Measure one task with commands that hold the pose."""
    env = _make(task, embodiment, action_type, cameras=False)
    obs = env.get_obs()
    hold = {key: obs["state"][key] for key in get_embodiment(embodiment).dims(action_type)}
    physics = env.episodes[0].physics
    hertz = round(obs["additional_info"]["frequency"])
    count = round(1.0 / (hertz * physics.model.opt.timestep))
    times = alternate(
        {
            "act": lambda: env.take_action(hold),
            "raw": lambda: mujoco.mj_step(physics.model, physics.data, count),
            "look": env.get_obs,
        },
        10,
    )
    return {
        "task": f"{task}, {embodiment}, {action_type}",
        "hz": hertz,
        "physics_steps": count,
        "act_ms": times["act"],
        "step_ms": times["act"] + times["look"],
        "raw_ms": times["raw"],
        "reset_ms": alternate({"reset": lambda: env.reset([0])}, 1, rounds=3)["reset"],
    }


def pictures(task: str, size: tuple[int, int], renderer: str) -> float:
    """Return the milliseconds for the pictures of all cameras of one observation.

    Raises:
        RuntimeError: this machine lacks what the renderer needs.
    """
    env = _make(task, ROBOT, "joint", cameras=list(size), renderer=renderer)
    episode = env.episodes[0]

    def look() -> None:
        for camera in episode.cameras.values():
            camera.render(episode.physics.data)

    measure = alternate if renderer == RAYCAST else wall
    taken = measure({"look": look}, 1, rounds=15)["look"]
    env.close()
    return taken


def _make(task: str, embodiment: str, action_type: str, **config: Any) -> Any:
    make = load_module(room("envs") / "mujoco" / "client.py").make
    settings = {"task": task, "embodiment": embodiment, "action_type": action_type, "max_steps": 10**9}
    env = make({**settings, **config})
    env.reset([0])
    return env
