"""Runs in the Python of envs/maniskill: moves its arms, and prints observations as JSON."""

from __future__ import annotations

import os
from typing import Any

import looking
import numpy as np
from looking import make

from xpl import rotation

PANDA, STICK, SO100, PAIR = "panda_maniskill", "panda_stick", "so100", "panda_maniskill_dual"
STEPS = 30
SIZE = 128


def _episode(env: Any) -> Any:
    return env._envs[0]._episode


def _kinematics(env: Any) -> dict[str, Any]:
    """What joints and poses say, and where ManiSkill's own tool and base are, of the first arm."""
    (agent, *_) = [arm.agent for arm in _episode(env)._arms]
    own = {name: getattr(agent, name).pose.raw_pose[0].tolist() for name in ("robot", "tcp") if hasattr(agent, name)}
    return {"state": looking.listed(env.get_obs()["state"]), **own}


def _by_poses() -> dict[str, Any]:
    """A Panda that is told poses: where its tool goes and turns, what its fingers do."""
    env = make("maniskill", task="PickCube", embodiment=PANDA)
    results = {"axes": looking.along_axes(env, 0.05, steps=STEPS), "openings": looking.openings(env, steps=STEPS)}
    results["turns"] = looking.turns(env, steps=STEPS)
    results["kinematics"] = _kinematics(env)
    results["again"] = _played_twice(env)
    env.close()
    return results


def _played_twice(env: Any) -> int:
    """Return how many of three episodes that are played twice end differently, with others between them."""
    digests = []
    for seed in (1, 2, 3, 1, 2, 3):
        env.reset([seed])
        for step in range(STEPS):
            env.take_action(looking.command(env.get_obs(), (0.02, 0.01, -0.03), opening=step % 2))
        digests.append(env.results()[0]["digest"])
    return sum(first != again for first, again in zip(digests[:3], digests[3:], strict=True))


def _by_changes() -> dict[str, Any]:
    """A Panda that is told changes of poses, which a policy adds up: what ManiSkill is told, where its tool goes."""
    env = make("maniskill", task="PickCube", embodiment=PANDA, setting="delta")
    results: dict[str, Any] = {"told": looking.changes(env, (0.05, -0.05, 0.025), steps=3)}
    results["moved"] = [_added_up(env, np.append(0.01 * axis, np.zeros(3)))["moved"] for axis in np.eye(3)]
    turns = [_added_up(env, np.append(np.zeros(3), 0.02 * axis)) for axis in np.eye(3)]
    results["turned"], results["turns_told"] = [turn["turned"] for turn in turns], [turn["told"] for turn in turns]
    arm = _episode(env)._arms[0].agent.controller.controllers
    results["range"] = [arm["arm"].config.pos_upper, arm["arm"].config.rot_lower]
    results["fingers"] = [arm["gripper"].config.lower, arm["gripper"].config.upper]
    env.close()
    return results


def _added_up(env: Any, change: np.ndarray, steps: int = 12) -> dict[str, list[float]]:
    """Add a change (6,) to the commanded pose in each step; return how far the tool went, and what was told first."""
    env.reset([0])
    before = env.get_obs()["state"]["tcp_pose"]
    action = looking.command(env.get_obs(), opening=1.0)
    pose, commands = action["ee_pose"].astype(np.float64), []
    for _ in range(steps):
        pose[:3] += change[:3]
        pose[3:] = rotation.multiply(rotation.from_axis_angle(change[3:]), pose[3:])
        env.take_action({**action, "ee_pose": pose.astype(np.float32)})
        commands.append(looking.told(env).tolist())
    after = env.get_obs()["state"]["tcp_pose"]
    turn = rotation.to_axis_angle(rotation.multiply(after[3:], rotation.conjugate(before[3:])))
    return {"moved": (after - before)[:3].tolist(), "turned": turn.tolist(), "told": commands[0]}


def _by_angles(task: str, robot: str, setting: str = "clean") -> dict[str, Any]:
    """An arm that is told angles: where its joints go, what ManiSkill is told, what joints and poses say."""
    env = make("maniskill", task=task, embodiment=robot, action_type="joint", setting=setting)
    env.reset([0])
    first = env.get_obs()["state"]
    moved = np.float32([0.1, -0.05, 0.05, 0.1, -0.1, 0.05, 0.1][: len(first["arm_joint_state"])])
    angles = first["arm_joint_state"].copy()
    commands = []
    for step in range(STEPS):
        if setting == "clean" or step < 4:
            angles = angles + moved / 4 if step < 4 else angles
        env.take_action({"arm_joint_state": angles, "ee_joint_state": np.float32([1.0])})
        commands.append(looking.told(env).tolist())
    after = env.get_obs()["state"]
    results = {
        "wanted": moved.tolist(),
        "moved": (after["arm_joint_state"] - first["arm_joint_state"]).tolist(),
        "told": commands[0],
        "kinematics": _kinematics(env),
    }
    env.close()
    return results


def _jaw() -> list[float]:
    """Return how far the tips of an SO-100 are apart, m, closed and opened."""
    env = make("maniskill", task="PickCubeSO100", embodiment=SO100, action_type="joint")
    env.reset([0])
    agent, apart = _episode(env)._arms[0].agent, []
    for opening in (0.0, 1.0):
        action = {"arm_joint_state": env.get_obs()["state"]["arm_joint_state"], "ee_joint_state": np.float32([opening])}
        for _ in range(STEPS):
            env.take_action(action)
        apart.append(float(np.linalg.norm((agent.finger1_tip.pose.p - agent.finger2_tip.pose.p)[0].numpy())))
    env.close()
    return apart


def _solved() -> dict[str, Any]:
    """An SO-100 that is told poses: where its flange goes, up and ahead."""
    env = make("maniskill", task="PickCubeSO100", embodiment=SO100)
    results = {}
    for name, moved in {"up": (0, 0, 0.02), "ahead": (0.02, 0, 0)}.items():
        env.reset([0])
        first = env.get_obs()
        action = looking.command(first, moved)
        for _ in range(STEPS):
            env.take_action(action)
        results[name] = (env.get_obs()["state"]["ee_pose"] - first["state"]["ee_pose"])[:3].tolist()
    env.close()
    return results


def _pair() -> dict[str, Any]:
    """Two Pandas: how far each tool goes when only one is told to move, and where they stand."""
    env = make("maniskill", task="TwoRobotPickCube", embodiment=PAIR)
    results: dict[str, Any] = {}
    for side in ("left", "right"):
        env.reset([0])
        first = env.get_obs()["state"]
        action = {name: first[name].copy() for name in first if name.endswith(("ee_pose", "ee_joint_state"))}
        action[f"{side}_ee_pose"][:3] += np.float32([0.05, 0.0, 0.0])
        for _ in range(STEPS):
            env.take_action(action)
        after = env.get_obs()["state"]
        results[side] = {
            other: (after[f"{other}_tcp_pose"] - first[f"{other}_tcp_pose"])[:3].tolist() for other in ("left", "right")
        }
    results["bases"] = {arm.prefix: arm.base.tolist() for arm in _episode(env)._arms}
    env.close()
    return results


def _seen() -> dict[str, Any]:
    """Whether what is at a known point has its color in the picture, in both cameras of a Panda with a wrist camera."""
    env = make("maniskill", task="StackCube", embodiment=PANDA, cameras=[SIZE, SIZE])
    env.reset([0])
    obs = env.get_obs()
    cubes = {name: obs["privileged"]["observation"]["extra"][f"cube{name}_pose"][:3] for name in "AB"}
    results: dict[str, Any] = {}
    for camera, view in obs["vision"].items():
        pixels = {name: looking.projected(view, position) for name, position in cubes.items()}
        inside = {
            name: position
            for name, position in pixels.items()
            if max(map(abs, position)) < SIZE - 1 and min(position) > 0
        }
        results[camera] = {name: looking.colored(view["color"], position) for name, position in inside.items()}
    head = obs["vision"]["cam_head"]
    results["above"] = [looking.projected(head, cubes["A"] + [0, 0, lift])[1] for lift in (0.0, 0.1)]
    simulation = _episode(env)._env
    theirs = simulation._get_obs_sensor_data()["base_camera"]["rgb"][0].numpy()
    results["apart"] = float(np.abs(theirs.astype(int) - head["color"].astype(int)).max())
    env.close()
    results["goal"] = [_green(setting) for setting in ("clean", "goal")]
    return results


def _green(setting: str) -> float:
    """Return how green the goal's place is, compared with its red, in a task whose goal ManiSkill hides."""
    env = make("maniskill", task="PickCube", embodiment=PANDA, setting=setting, cameras=[SIZE, SIZE])
    env.reset([1])
    obs = env.get_obs()
    head = obs["vision"]["cam_head"]
    red, green, _ = looking.colored(
        head["color"], looking.projected(head, obs["privileged"]["observation"]["extra"]["goal_pos"])
    )
    env.close()
    return green - red


def _refused() -> dict[str, str]:
    """What is said for a task whose assets are missing, and for changes of poses of an SO-100."""
    errors = {}
    for name, config in {
        "assets": {"task": "PickSingleYCB", "embodiment": PANDA},
        "changes": {"task": "PickCubeSO100", "embodiment": SO100, "setting": "delta"},
    }.items():
        try:
            make("maniskill", **config).reset([0])
            errors[name] = ""
        except Exception as error:  # noqa: BLE001 - what it says is judged
            errors[name] = f"{type(error).__name__}: {error}"
    return errors


def _without_driver() -> str:
    """Return what is said where Vulkan finds no driver."""
    os.environ["VK_ICD_FILENAMES"] = "/nowhere"
    try:
        make("maniskill", task="PickCube", embodiment=PANDA).reset([0])
    except Exception as error:  # noqa: BLE001 - what it says is judged
        return f"{type(error).__name__}: {error}"
    return ""


def _every_task() -> dict[str, str]:
    """Return why a task that is offered without assets cannot be played a step of; "" where it can."""
    from xpl.environment import read_manifest

    manifest = read_manifest(looking.ROOT / "envs" / "maniskill").data
    errors = {}
    for task, facts in manifest["tasks"].items():
        robots = [robot for robot in manifest["embodiments"] if robot not in facts["unsupported"]]
        if not robots or "assets" in facts:
            continue
        try:
            env = make("maniskill", task=task, embodiment=robots[0], action_type="joint")
            env.reset([0])
            state = env.get_obs()["state"]
            env.take_action({name: value for name, value in state.items() if "joint_state" in name})
            errors[task] = ""
            env.close()
        except Exception as error:  # noqa: BLE001 - what it says is judged
            errors[task] = f"{type(error).__name__}: {error}"
    return errors


PARTS = {
    "poses": _by_poses,
    "changes": _by_changes,
    "angles": lambda: _by_angles("PickCube", PANDA),
    "angle_changes": lambda: _by_angles("PickCube", PANDA, "delta"),
    "stick": lambda: _by_angles("PushT", STICK),
    "so100": lambda: _by_angles("PickCubeSO100", SO100),
    "jaw": _jaw,
    "solved": _solved,
    "pair": _pair,
    "seen": _seen,
    "refused": _refused,
    "tasks": _every_task,
    "driver": _without_driver,
}


if __name__ == "__main__":
    looking.show(PARTS)
