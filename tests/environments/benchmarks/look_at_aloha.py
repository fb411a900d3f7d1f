"""Runs in the Python of envs/aloha: moves the arms, observes, replays in gym-aloha itself; prints JSON."""

from __future__ import annotations

from typing import Any

import looking
import numpy as np

from xpl import get_embodiment
from xpl.kinematics import Chain
from xpl.poses import compose, invert

ROBOT = "aloha"
KNOWN = {"embodiment": ROBOT, "action_type": "joint"}
CHAIN = Chain.from_embodiment(get_embodiment(ROBOT).data)
ARMS = ("left", "right")


def _make(**config: Any) -> Any:
    return looking.make("aloha", task="transfer_cube", **KNOWN, **config)


def _command(obs: dict[str, Any]) -> dict[str, Any]:
    state = obs["state"]
    return {
        f"{arm}_{key}": state[f"{arm}_{key}"].copy() for arm in ARMS for key in ("arm_joint_state", "ee_joint_state")
    }


def _bases(env: Any) -> dict[str, np.ndarray]:
    episode = env._envs[0]._episode
    return {arm: episode._body(episode._physics.model.name2id(f"vx300s_{arm}", "body")) for arm in ARMS}


def _moved(env: Any, arm: str, axis: np.ndarray) -> list[float]:
    """Return how far the fingertips went, m, while the joints were sent where kinematics has the flange moved."""
    env.reset([0])
    first = env.get_obs()
    action, flange = _command(first), first["state"][f"{arm}_ee_pose"].astype(np.float64)
    flange[:3] += axis
    key = f"{arm}_arm_joint_state"
    action[key] = CHAIN.solve(compose(invert(_bases(env)[arm]), flange), action[key]).joints.astype(np.float32)
    for _ in range(looking.STEPS):
        env.take_action(action)
    return (env.get_obs()["state"][f"{arm}_tcp_pose"] - first["state"][f"{arm}_tcp_pose"])[:3].tolist()


def _openings(env: Any) -> dict[str, list[float]]:
    env.reset([0])
    openings_by_arm: dict[str, list[float]] = {arm: [] for arm in ARMS}
    for opening in (1.0, 0.0):  # an episode begins with fingers nearly shut
        action = _command(env.get_obs())
        for arm in ARMS:
            action[f"{arm}_ee_joint_state"][:] = opening
        for _ in range(2 * looking.STEPS):
            env.take_action(action)
        for arm in ARMS:
            openings_by_arm[arm].append(float(env.get_obs()["state"][f"{arm}_ee_joint_state"][0]))
    return openings_by_arm


def _still() -> dict[str, Any]:
    env = _make()
    axes = {
        sign + "xyz"[place]: (far * np.eye(3)[place]) for sign, far in (("+", 0.04), ("-", -0.04)) for place in range(3)
    }
    results: dict[str, Any] = {
        "axes": {arm: {way: _moved(env, arm, axis) for way, axis in axes.items()} for arm in ARMS}
    }
    results["openings"] = _openings(env)
    results["state"], results["bases"] = looking.listed(env.get_obs()["state"]), looking.listed(_bases(env))
    rng, solved = np.random.default_rng(1), 0
    for seed in range(2):
        env.reset([seed])
        first = _command(env.get_obs())
        while not env.is_episode_end():
            env.take_action({key: value + np.float32(rng.normal(0, 0.05, value.shape)) for key, value in first.items()})
        solved += env.results()[0]["success"]
    results["rewards"] = _rewards(env)
    env.close()
    return {**results, "guessed": solved}


def _rewards(env: Any) -> list[list[int]]:
    """Return the rewards of the expert's episode as they come, once each, ours and those that gym-aloha computes."""
    env.reset([0])
    episode, rewards = env._envs[0]._episode, []
    while not env.is_episode_end():
        obs = env.get_obs()
        env.take_action({key: value.astype(np.float32) for key, value in obs["privileged"]["expert"].items()})
        pair = [int(episode._reward), int(type(episode._task).get_reward(episode._task, episode._physics))]
        if pair not in rewards:
            rewards.append(pair)
    return rewards


def _seen() -> dict[str, Any]:
    """Play here and in gym-aloha's own environment, with its pictures, and look for known points in ours."""
    import gym_aloha  # noqa: F401 - registers its environments
    import gymnasium

    env = _make(cameras=True)
    env.reset([3])
    own = gymnasium.make("gym_aloha/AlohaTransferCube-v0", obs_type="pixels_agent_pos").unwrapped
    own.reset(seed=3)
    obs, rng, different = env.get_obs(), np.random.default_rng(0), 0
    for _ in range(4):
        action = {key: value + np.float32(rng.normal(0, 0.02, value.shape)) for key, value in _command(obs).items()}
        env.take_action(action)
        theirs, *_ = own.step(looking.told(env))
        obs = env.get_obs()
        different += int((theirs["agent_pos"] != env.simulated().observation["agent_pos"]).any())
        different += int((theirs["pixels"]["top"] != obs["vision"]["cam_head"]["color"]).any())
    physics = env._envs[0]._episode._physics
    results: dict[str, Any] = {"different": different, "box": {"cam_head": _color_of_the_box(obs, "cam_head")}}
    for side, arm in (("left", "vx300s_right"), ("right", "vx300s_left")):
        view, point = obs["vision"][f"cam_{side}_wrist"], physics.named.data.xpos[f"{arm}/shoulder_link"]
        column, row = (round(value - 0.5) for value in looking.projected(view, point))
        bodies = physics.render(480, 640, camera_id=f"{side}_wrist", segmentation=True)[..., 0]
        pixels = [int(bodies[row, column]), int(bodies[479 - row, column])]
        results[side] = [pixel >= 0 and physics.model.id2name(pixel, "geom").startswith(arm) for pixel in pixels]
    for setting in ("angle", "front_close", "left_pillar", "right_pillar"):
        env.reset([3], {"setting": setting})
        obs = env.get_obs()
        results[setting] = list(obs["vision"])
        if setting != "front_close":  # which does not see it
            results["box"][setting] = _color_of_the_box(obs, "cam_third_view")
    env.close()
    return results


def _color_of_the_box(obs: dict[str, Any], camera: str) -> list[float]:
    view = obs["vision"][camera]
    return looking.colored(view["color"], looking.projected(view, obs["privileged"]["box"][:3]))


if __name__ == "__main__":
    looking.show({"still": _still, "seen": _seen})
