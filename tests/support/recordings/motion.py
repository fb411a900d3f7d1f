"""Real motion for tests of demonstrations: episodes that the scripted expert plays in the MuJoCo environment."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from xpl import get_embodiment
from xpl.kinematics import Chain
from xpl_cli.basics.content import content_folder, load_module

CAMERAS = ("cam_head", "cam_wrist", "cam_left_wrist", "cam_right_wrist")
RATE = 25.0
"""Control steps per second of the environment."""


@dataclass(frozen=True)
class Motion:
    """What one episode really was; N steps.

    Attributes:
        robot: name of the embodiment.
        joints, commands: by arm (N, dof) rad, measured and commanded.
        opening, grip: by arm (N,) 0 closed, 1 open, measured and commanded.
        poses, targets: by arm (N, 7) of the flange in the world, measured and commanded, quaternions wxyz.
        images: by camera (N, H, W, 3) RGB; none where nothing was rendered.
        instruction: the sentence.
    """

    robot: str
    joints: dict[str, np.ndarray]
    commands: dict[str, np.ndarray]
    opening: dict[str, np.ndarray]
    grip: dict[str, np.ndarray]
    poses: dict[str, np.ndarray]
    targets: dict[str, np.ndarray]
    images: dict[str, np.ndarray]
    instruction: str

    @property
    def length(self) -> int:
        """Steps."""
        return len(next(iter(self.joints.values())))


@cache
def motion(task: str, robot: str, seed: int, *, cameras: bool = False, most: int = 400) -> Motion:
    """Let the expert play an episode in this process, and return what happened."""
    expert = load_module(content_folder("policy") / "scripted_expert" / "model.py").Model
    make = load_module(content_folder("envs") / "mujoco" / "client.py").make
    config: dict[str, Any] = {"task": task, "embodiment": robot, "cameras": cameras, "privileged": True}
    env, policy = make(config), expert({"env_cfg_type": robot, "action_type": "joint"})
    embodiment = get_embodiment(robot)
    chain = Chain.from_embodiment(embodiment.data)
    env.reset([seed])
    positions: dict[str, dict[str, list[Any]]] = {}
    instruction = ""
    base: dict[str, np.ndarray] = {}

    def keep(kind: str, name: str, value: Any) -> None:
        positions.setdefault(kind, {}).setdefault(name, []).append(np.array(value))

    step = 0
    while not env.is_episode_end() and step < most:
        obs = env.get_obs()
        instruction = str(obs["instruction"])
        policy.update_obs(obs)
        (action,) = policy.get_action()
        for arm in embodiment.arms:
            name = arm.prefix.rstrip("_") or "single"
            base[name] = np.array(obs["privileged"][f"{arm.prefix}base_pose"], np.float64)
            keep("joints", name, obs["state"][f"{arm.prefix}arm_joint_state"])
            keep("opening", name, obs["state"][f"{arm.prefix}ee_joint_state"][0])
            keep("commands", name, action[f"{arm.prefix}arm_joint_state"])
            keep("grip", name, action[f"{arm.prefix}ee_joint_state"][0])
        for camera, frames in obs.get("vision", {}).items():
            keep("images", camera, frames["color"][::8, ::8])
        env.take_action(action)
        step += 1
    env.close()
    stacked = {kind: {name: np.stack(rows) for name, rows in entry.items()} for kind, entry in positions.items()}
    poses, targets = (
        {name: _flange(chain, base[name], rows) for name, rows in stacked[kind].items()}
        for kind in ("joints", "commands")
    )
    return Motion(
        robot,
        stacked["joints"],
        stacked["commands"],
        stacked["opening"],
        stacked["grip"],
        poses,
        targets,
        stacked.get("images", {}),
        instruction,
    )


def _flange(chain: Chain, base: np.ndarray, joints: np.ndarray) -> np.ndarray:
    from xpl.poses import compose

    return compose(base, np.stack([chain.flange(row) for row in joints]))
