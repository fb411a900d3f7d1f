"""Runs in the Python of envs/robotwin: runs tasks with a mock robot and prints observations as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import looking
import numpy as np

from xpl.process.modules import load_module

SETTING, SEED = "stand_in_robot", 100_000
HEAD, STILL = "cam_head", 4
FOLDER = looking.ROOT / "envs" / "robotwin"
SIDES = ("left", "right")


def _env(task: str = "stack_blocks_two", **config: Any) -> Any:
    defaults = {
        "task": task,
        "embodiment": "aloha_agilex",
        "setting": SETTING,
        "action_type": "joint",
        "privileged": False,
    }
    return looking.make("robotwin", **{**defaults, **config})


def _task(env: Any) -> Any:
    """Return RoboTwin's own task."""
    return env._envs[0]._episode._task


def _hold(obs: Mapping[str, Any], part: str = "arm_joint_state") -> dict[str, Any]:
    names = [f"{side}_{name}" for side in SIDES for name in (part, "ee_joint_state")]
    return {name: obs["state"][name].copy() for name in names}


def _measured(task: Any) -> list[float]:
    """Return the angles that RoboTwin measures, left arm first."""
    return [float(angle) for side in SIDES for angle in getattr(task.robot, f"get_{side}_arm_real_jointState")()[:-1]]


def _fingers(task: Any) -> list[float]:
    """Return how far each finger is open, m: left arm first."""
    names = [joint.get_name() for joint in task.robot.left_entity.get_active_joints()]
    angles = dict(zip(names, task.robot.left_entity.get_qpos(), strict=True))
    return [float(angles[f"{arm}_joint{number}"]) for arm in ("fl", "fr") for number in (7, 8)]


def _joints() -> dict[str, Any]:
    """What is observed of a scene, and what commands of angles and grippers do to the arms."""
    env, results = _env(cameras=True), {}
    env.reset([SEED])
    task, first = _task(env), env.get_obs()
    results["observed"] = {name: list(np.asarray(view["color"]).shape) for name, view in first["vision"].items()}
    results["seen"] = _seen(first, task)
    theirs = env.simulated().observation
    results["same"] = bool((theirs["observation"]["head_camera"]["rgb"] == first["vision"][HEAD]["color"]).all())
    results["moved"] = [_one_joint(env, arm, joint) for arm, joint in [(0, 0), (0, 1), (0, 3), (1, 2), (1, 4), (1, 5)]]
    results["lag"] = _lag(env)
    results["kinematics"] = _kinematics(env)
    results["fingers"] = []
    for opening in (0.0, 1.0):
        action = {**_hold(env.get_obs()), **{f"{side}_ee_joint_state": np.float32([opening]) for side in SIDES}}
        for _ in range(STILL):
            env.take_action(action)
        openings = [float(env.get_obs()["state"][f"{side}_ee_joint_state"][0]) for side in SIDES]
        results["fingers"].append({"measured": _fingers(task), "told": openings})
    env.close()
    return results


def _seen(obs: Mapping[str, Any], task: Any) -> dict[str, Any]:
    """The colors at the tops of the blocks in the head's picture, and the row of a point and of one above it."""
    view, results = obs["vision"][HEAD], {}
    for name, block in (("red", task.block1), ("green", task.block2)):
        top = np.add(block.get_pose().p, [0, 0, 0.02])
        results[name] = looking.colored(np.asarray(view["color"]), looking.projected(view, top))
    results["rows"] = [looking.projected(view, [0.0, 0.0, 0.741 + lift])[1] for lift in (0.0, 0.1)]
    results["columns"] = [looking.projected(view, [beside, 0.0, 0.741])[0] for beside in (-0.1, 0.1)]
    return results


def _one_joint(env: Any, arm: int, joint: int) -> dict[str, Any]:
    """How far each joint is sent and gets when one is sent 0.15 rad on."""
    obs, task = env.get_obs(), _task(env)
    action, before = _hold(obs), _measured(task)
    action[f"{SIDES[arm]}_arm_joint_state"][joint] += np.float32(0.15)
    for _ in range(STILL):
        env.take_action(action)
    measured = np.concatenate([env.get_obs()["state"][f"{side}_arm_joint_state"] for side in SIDES])
    target = np.concatenate([obs["state"][f"{side}_arm_joint_state"] for side in SIDES])
    return {
        "place": 6 * arm + joint,
        "told": (measured - target).tolist(),
        "measured": (np.array(_measured(task)) - before).tolist(),
    }


def _lag(env: Any) -> dict[str, float]:
    """How far the observed and the measured angle are from a command right after it."""
    action = _hold(env.get_obs())
    action["left_arm_joint_state"][1] += np.float32(0.1)
    env.take_action(action)
    commanded, measured = (float(state["left_arm_joint_state"][1]) for state in (action, env.get_obs()["state"]))
    for _ in range(STILL):
        env.take_action(action)
    return {"told": abs(measured - commanded), "measured_later": abs(_measured(_task(env))[1] - commanded)}


def _kinematics(env: Any) -> dict[str, Any]:
    robot = load_module(FOLDER / "stand_in_robot.py")
    state = {name: value for name, value in env.get_obs()["state"].items() if "joint" not in name}
    return {
        "measured": _measured(_task(env)),
        "bases": [robot.base(side).tolist() for side in SIDES],
        "poses": looking.listed(state),
    }


def _poses() -> dict[str, Any]:
    """Where tools go that are sent along an axis, and what is said of a place that no arm reaches."""
    env, results = _env(action_type="ee"), {"axes": []}
    env.reset([SEED])
    for axis in np.eye(3):
        before = env.get_obs()
        action = _hold(before, "ee_pose")
        action["left_ee_pose"][:3] += np.float32(0.04 * axis)
        for _ in range(STILL):
            report = env.take_action(action)
        after = env.get_obs()["state"]
        moved = [(after[f"{side}_tcp_pose"] - before["state"][f"{side}_tcp_pose"])[:3].tolist() for side in SIDES]
        results["axes"].append({"wanted": (0.04 * axis).tolist(), "moved": moved, "corrections": report["corrections"]})
    action = _hold(env.get_obs(), "ee_pose")
    for _ in range(20):  # as fast as limits let it
        action["right_ee_pose"][2] = np.float32(2.5)
        report = env.take_action(action)
        if "unreached" in report["corrections"].get("right_", {}):
            break
    results["unreached"] = report["corrections"]
    results["again"] = [_both_arms(env) for _ in range(2)]
    env.close()
    return results


def _both_arms(env: Any) -> str:
    """Return the digest of an episode in which both arms go somewhere."""
    env.reset([SEED])
    action = _hold(env.get_obs(), "ee_pose")
    for _ in range(3):
        for side in SIDES:
            action[f"{side}_ee_pose"][0] += np.float32(0.02)
        env.take_action(action)
    return str(env.results()[0]["digest"])


def _won() -> dict[str, Any]:
    """An episode that is won by placing its blocks by hand, and one that reaches its limit of steps."""
    import sapien

    env = _env(max_steps=3)
    env.reset([SEED])
    task, action = _task(env), _hold(env.get_obs())
    env.take_action(action)
    results: dict[str, Any] = {"before": [bool(task.check_success()), env.is_episode_end()]}
    below = task.block1.get_pose()
    task.block2.actor.set_pose(sapien.Pose([*below.p[:2], below.p[2] + 0.0502], below.q))
    env.take_action(action)
    results["won"] = env.results()[0]
    env.reset([SEED])
    for _ in range(4):
        env.take_action(action)
    results["limit"] = env.results()[0]
    env.close()
    return results


def _tasks() -> dict[str, Any]:
    """How each task that can be played begins, twice, and with another seed; and what is refused."""
    from xpl.environment import read_manifest

    results: dict[str, Any] = {}
    for task in read_manifest(FOLDER).data["stand_ins"][SETTING]["tasks"]:
        env, begun = _env(task), []
        for seed in (SEED, SEED + 1, SEED):
            env.reset([seed])
            obs = env.get_obs()
            things = [np.round(entity.get_pose().p, 6).tolist() for entity in _task(env).scene.get_all_actors()]
            begun.append({"things": things, "instruction": obs["instruction"]})
            if seed == SEED:
                env.take_action(_hold(obs))
        results[task] = begun
        env.close()
    try:
        _env("stack_bowls_two").reset([SEED])
    except ValueError as error:
        results["refused"] = str(error)
    return results


class _ByHand:
    """A policy that holds still, and wins by moving blocks in the simulator when it is asked for the second time."""

    def __init__(self) -> None:
        self.task: Any = None
        self.names: list[str] = []
        self._obs: Any = None

    def call(self, func_name: str, obs: Any = None) -> Any:
        self.names.append(func_name)
        if func_name == "update_obs":
            self._obs = obs
        if func_name != "get_action":
            return None
        if self.names.count("get_action") == 2:
            import sapien

            below = self.task.block1.get_pose()
            self.task.block2.actor.set_pose(sapien.Pose([*below.p[:2], below.p[2] + 0.0502], below.q))
        return [_hold(self._obs)]


def _loop() -> dict[str, Any]:
    """RoboTwin's own loop: a first seed that RoboTwin finds unstable, and a second that is won."""
    from xpl import get_embodiment
    from xpl.environment import read_manifest

    loop, without_gpu = (load_module(FOLDER / f"{name}.py") for name in ("loop", "without_gpu"))
    source, client = without_gpu.WithStandIn(), _ByHand()
    make = source.make

    def made(name: str) -> Any:
        client.task = task = make(name)
        stable, seeds = task.check_stable, []

        def check_stable() -> Any:
            seeds.append(0)
            return (False, ["box"]) if len(seeds) == 1 else stable()

        task.check_stable = check_stable
        return task

    source.make = made
    robot, cameras = get_embodiment("aloha_agilex"), read_manifest(FOLDER).data["cameras"]
    played = loop.evaluate(source, client, loop.Wishes("stack_blocks_two", test_num=1), robot, cameras)
    return {"episodes": played.episodes, "skipped": played.skipped, "rate": played.rate, "names": client.names}


if __name__ == "__main__":
    looking.show({"joints": _joints, "poses": _poses, "won": _won, "tasks": _tasks, "loop": _loop})
