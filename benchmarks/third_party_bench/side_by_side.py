"""Run one benchmark here and in its own bare loop, by turns, with the same commands; print the figures as JSON.

Runs in the Python of the environment package.
"""

# ruff: noqa: SLF001 - what is compared looks behind observations

from __future__ import annotations

import contextlib
import io
import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from xpl.process.modules import load_module  # noqa: E402 - this Python has no xpl but the checkout's

SIZE = (128, 128)
SEED = 0
TASKS = {
    "metaworld": "pick-place",
    "libero": "libero_spatial_0",
    "aloha": "transfer_cube",
    "maniskill": "StackCube",
    "robosuite": "Lift",
}

# Numbers of the state that wander: a place, m, or joints, rad.
WANDERING = {"ee_pose": 3, "left_arm_joint_state": 6, "right_arm_joint_state": 6}
Loop = tuple[Callable[[], None], Callable[[Any], Any]]


def ours(name: str, embodiment: str, cameras: Any) -> Any:
    """Return our environment."""
    config = {"task": TASKS[name], "embodiment": embodiment, "cameras": cameras}
    return load_module(ROOT / "envs" / name / "client.py").make(config)


def trajectory(env: Any, steps: int) -> tuple[list[dict[str, Any]], list[np.ndarray]]:
    """Return actions that wander about the first state, and the simulator's commands for them."""
    rng = np.random.default_rng(SEED)
    env.reset([SEED])
    first = env.get_obs()["state"]
    now, actions, values = {key: first[key].copy() for key in WANDERING if key in first}, [], []
    for _ in range(steps):
        for key, value in now.items():
            begun, free = first[key], slice(WANDERING[key])
            value[free] = begun[free] + np.clip(
                value[free] - begun[free] + rng.normal(0, 0.004, value[free].shape), -0.05, 0.05
            )
        openings = {key: np.float32([rng.uniform()]) for key in first if key.endswith("ee_joint_state")}
        actions.append(
            {**{key: value.astype(np.float32) for key, value in now.items()}, **openings}
        )  # as a server sends
        env.take_action(actions[-1])
        values.append(np.array(env.simulated().command))
    return actions, values


def bare_metaworld(_env: Any, size: tuple[int, int] | None) -> Loop:
    """Return Meta-World's own reset and step; with the pictures of both cameras, drawn by its own renderer."""
    from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer
    from metaworld.env_dict import ALL_V3_ENVIRONMENTS

    env = ALL_V3_ENVIRONMENTS[f"{TASKS['metaworld']}-v3"]()
    vars(env).update(_partially_observable=False, _set_task_called=True, _freeze_rand_vec=False)
    del env.sawyer_observation_space
    env.seeded_rand_vec = True
    names = ("corner2", "gripperPOV") if size else ()
    drawing = [MujocoRenderer(env.model, env.data, width=size[1], height=size[0], camera_name=name) for name in names]

    def reset() -> None:
        env.seed(SEED)
        env.reset()

    def step(command: Any) -> Any:
        return env.step(command), [each.render("rgb_array") for each in drawing]

    return reset, step


def bare_libero(mine: Any, size: tuple[int, int] | None) -> Loop:
    """Return LIBERO's own reset and step."""
    from libero.libero.envs.env_wrapper import ControlEnv, OffScreenRenderEnv

    episode = mine._places[0]._episode
    file = episode._env.env.bddl_file_name
    if size:
        env = OffScreenRenderEnv(bddl_file_name=file, camera_heights=size[0], camera_widths=size[1])
    else:
        env = ControlEnv(file, has_offscreen_renderer=False, use_camera_obs=False)

    def reset() -> None:
        env.seed(0)
        env.reset()
        env.set_init_state(episode._states[SEED])
        for _ in range(10):
            env.step([0.0] * 6 + [-1.0])

    return reset, env.step


def bare_aloha(_env: Any, size: tuple[int, int] | None) -> Loop:
    """Return gym-aloha's own reset and step; it draws three pictures, here of the cameras and the size that we draw."""
    from gym_aloha.env import AlohaEnv

    env = AlohaEnv(task=TASKS["aloha"], obs_type="pixels_agent_pos")
    task, nothing = env._env.task, np.zeros((1, 1, 3), dtype=np.uint8)

    def observed(physics: Any) -> dict[str, Any]:
        names = ("top", "left_wrist", "right_wrist") if size else ()
        images = {name: physics.render(height=size[0], width=size[1], camera_id=name) for name in names}
        observed = {
            "qpos": task.get_qpos(physics),
            "qvel": task.get_qvel(physics),
            "env_state": task.get_env_state(physics),
        }
        return {**observed, "images": images or {"top": nothing}}

    task.get_observation = observed
    return lambda: env.reset(seed=SEED), env.step


def bare_maniskill(mine: Any, size: tuple[int, int] | None) -> Loop:
    """Return ManiSkill's own reset and step, made without a wish but for pictures, the processor and poses."""
    import gymnasium

    del mine
    options: dict[str, Any] = {"control_mode": "pd_ee_pose", "sim_backend": "physx_cpu", "render_backend": "cpu"}
    if size:
        options.update(obs_mode="rgb", sensor_configs={"height": size[0], "width": size[1]})
    env = gymnasium.make(f"{TASKS['maniskill']}-v1", **options)
    return lambda: env.reset(seed=SEED), env.step


def bare_robosuite(_env: Any, size: tuple[int, int] | None) -> Loop:
    """Return robosuite's own reset and step."""
    import robosuite

    drawn = {"camera_names": ["agentview", "robot0_eye_in_hand"], "camera_heights": SIZE[0], "camera_widths": SIZE[1]}
    looks = {"has_offscreen_renderer": bool(size), "use_camera_obs": bool(size), **drawn}
    env = robosuite.make(TASKS["robosuite"], robots="Panda", ignore_done=True, seed=0, **looks)

    def reset() -> None:
        env.rng.bit_generator.state = np.random.default_rng(SEED).bit_generator.state
        env.reset()

    return reset, env.step


BARE = {
    "metaworld": bare_metaworld,
    "libero": bare_libero,
    "aloha": bare_aloha,
    "maniskill": bare_maniskill,
    "robosuite": bare_robosuite,
}


def time_steps(loop: Loop, commands: Sequence[Any]) -> list[float]:
    """Return the processor time of each step, ms; the reset is not counted."""
    reset, step = loop
    reset()
    times = []
    for command in commands:
        started = time.process_time()
        step(command)
        times.append(1e3 * (time.process_time() - started))
    return times


def mean_step(rounds: Sequence[list[float]]) -> float:
    """Return the mean time of a step; of each one the median of all rounds counts, so that no neighbour's work does."""
    return statistics.fmean(statistics.median(times) for times in zip(*rounds, strict=True))


def main() -> None:
    """Measure and print."""
    name, embodiment, with_cameras, steps, rounds = sys.argv[1:6]
    size = SIZE if with_cameras == "cameras" else None
    with contextlib.redirect_stdout(io.StringIO()):
        env = ours(name, embodiment, size or False)
        actions, values = trajectory(env, int(steps))
        bare = BARE[name](env, size)

        def play(action: Any) -> None:
            env.take_action(action)
            env.get_obs()

        mine, theirs = ((lambda: env.reset([SEED]), play), actions), (bare, values)
        timings = [(time_steps(*mine), time_steps(*theirs)) for _ in range(int(rounds))]
    ours_ms, bare_ms = (mean_step(times) for times in zip(*timings, strict=True))
    print(json.dumps({"ours_ms": ours_ms, "bare_ms": bare_ms, "ratio": bare_ms / ours_ms}))


if __name__ == "__main__":
    main()
