"""Actions of pi_0.5 as openpi's LIBERO example gets them: the simulator's observation, its server's policy, its plan.

`xpl model-io record` runs this, and audits compare the adapter with its actions. It uses nothing of model.py, and of
policy.yml nothing.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

CONVENTIONS = {
    "image_channels": "assumed: LIBERO renders RGB, and openpi's example exchanges no colours",
    "image_size": "Physical-Intelligence/openpi@15a9616a00943ada6c20a0f158e3adb39df2ccac:examples/libero/main.py:118 resize_with_pad",
    "image_range": "Physical-Intelligence/openpi@15a9616a00943ada6c20a0f158e3adb39df2ccac:examples/libero/main.py:117 convert_to_uint8",
    "image_orientation": "Physical-Intelligence/openpi@15a9616a00943ada6c20a0f158e3adb39df2ccac:examples/libero/main.py:115 agentview_image",
    "camera": "Physical-Intelligence/openpi@15a9616a00943ada6c20a0f158e3adb39df2ccac:examples/libero/main.py:116 robot0_eye_in_hand_image",
    "gripper": "Physical-Intelligence/openpi@15a9616a00943ada6c20a0f158e3adb39df2ccac:examples/libero/main.py:17 LIBERO_DUMMY_ACTION",
    "rotation": "assumed: robosuite's OSC_POSE takes a rotation vector, 1 is 0.5 rad",
    "frame": "assumed: robosuite's OSC_POSE moves along the axes of the world, 1 is 5 cm, and clips at 1",
    "point": "assumed: robosuite's OSC_POSE moves the point between the fingers",
    "action_reference": "assumed: robosuite's OSC_POSE takes changes; added up from command to command",
    "chunk": "Physical-Intelligence/openpi@15a9616a00943ada6c20a0f158e3adb39df2ccac:examples/libero/main.py:29 replan_steps",
    "instruction": "Physical-Intelligence/openpi@15a9616a00943ada6c20a0f158e3adb39df2ccac:examples/libero/main.py:140 prompt",
    "normalization": "assumed: LIBERO's own actions, whose scale is robosuite's; openpi denormalises to them",
    "sampling": "Physical-Intelligence/openpi@15a9616a00943ada6c20a0f158e3adb39df2ccac:src/openpi/policies/policy.py:68 noise",
}

REPLAN_STEPS = 5
TOOL = np.array([0.0, 0.0, 0.0965])
"""Of the flange, m: the point between LIBERO's fingers."""
HAND = np.array([0.924, 0.0, 0.0, -0.383]) / np.hypot(0.924, 0.383)
"""Quaternion (w, x, y, z) of Franka's hand at the flange: robosuite's of -45 degrees about z, as robot.xml rounds it."""


def multiply(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the product of two quaternions (w, x, y, z)."""
    (a, u), (b, v) = (first[0], first[1:]), (second[0], second[1:])
    return np.concatenate([[a * b - u @ v], a * v + b * u + np.cross(u, v)])


def rotate(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return a vector turned by a unit quaternion."""
    return multiply(multiply(quaternion, np.concatenate([[0.0], vector])), quaternion * [1, -1, -1, -1])[1:]


def from_vector(vector: np.ndarray) -> np.ndarray:
    """Return the quaternion of a rotation vector, rad."""
    angle = np.linalg.norm(vector)
    return np.concatenate([[np.cos(angle / 2)], np.sinc(angle / 2 / np.pi) / 2 * vector])


def simulated(now: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return LIBERO's observation of the same moment."""
    pose = np.asarray(now["state"]["ee_pose"], float)
    hand = multiply(pose[3:] / np.linalg.norm(pose[3:]), HAND)
    return {
        "robot0_eef_pos": pose[:3] + rotate(hand, TOOL),
        "robot0_eef_quat": np.roll(hand, -1),
        "robot0_gripper_qpos": np.array([0.04, -0.04]) * now["state"]["ee_joint_state"][0],
        "agentview_image": now["vision"]["cam_head"]["color"][::-1],  # upside down, as OpenGL gives it
        "robot0_eye_in_hand_image": now["vision"]["cam_wrist"]["color"][::-1],
    }


def quat2axisangle(quat: np.ndarray) -> np.ndarray:
    """Return the rotation vector of a quaternion (x, y, z, w), as the example's function does."""
    w = min(max(quat[3], -1.0), 1.0)
    den = math.sqrt(1.0 - w * w)
    return np.zeros(3) if math.isclose(den, 0.0) else quat[:3] * 2.0 * math.acos(w) / den


def answers(config: Mapping[str, Any]) -> Callable[[Any], list[dict[str, np.ndarray]]]:
    """Return what answers a question about an episode; `config` is deploy.yml after overrides."""
    from openpi.policies import policy_config
    from openpi.training import config as training
    from openpi_client import image_tools

    place = Path(__file__).parent / config["ckpt_name"]
    place = place if place.exists() else Path(__file__).parent / "checkpoints" / config["ckpt_name"]
    train = training.get_config(config["train_config"])
    written = json.loads((place / "config.json").read_text()) if (place / "config.json").exists() else {}
    names = [field.name for field in dataclasses.fields(train.model)]
    sizes = {key: value for key, value in {**written, **(config.get("model") or {})}.items() if key in names}
    train = dataclasses.replace(train, model=dataclasses.replace(train.model, **sizes))
    policy = policy_config.create_trained_policy(train, place)
    commands: dict[tuple[int, int, int], tuple[np.ndarray, np.ndarray]] = {}
    """By environment, episode and observation, the last command after the inference on it: point and hand."""

    def small(image: np.ndarray) -> np.ndarray:
        turned = np.ascontiguousarray(image[::-1, ::-1])
        return image_tools.convert_to_uint8(image_tools.resize_with_pad(turned, 224, 224))

    def answer(episode: Any) -> list[dict[str, np.ndarray]]:
        """Return the action steps that the example executes before it asks again."""
        obs = simulated(episode.observations[-1])
        element = {
            "observation/image": small(obs["agentview_image"]),
            "observation/wrist_image": small(obs["robot0_eye_in_hand_image"]),
            "observation/state": np.concatenate(
                (obs["robot0_eef_pos"], quat2axisangle(obs["robot0_eef_quat"]), obs["robot0_gripper_qpos"])
            ),
            "prompt": str(episode.observations[-1]["instruction"]),
        }
        noise = episode.rng.standard_normal((train.model.action_horizon, train.model.action_dim))
        plan = policy.infer(element, noise=noise.astype(np.float32))["actions"][:REPLAN_STEPS]
        earlier = [index for index in episode.asked if index < episode.asked[-1]]
        start = obs["robot0_eef_pos"], np.roll(obs["robot0_eef_quat"], 1)
        point, hand = commands[episode.env, episode.number, earlier[-1]] if earlier else start
        steps = []
        for action in np.clip(plan, -1, 1):  # as robosuite's controller does
            point, hand = point + 0.05 * action[:3], multiply(from_vector(0.5 * action[3:6]), hand)
            flange = np.concatenate([point - rotate(hand, TOOL), multiply(hand, HAND * [1, -1, -1, -1])])
            steps.append({"ee_pose": flange, "ee_joint_state": np.array([1.0 if action[6] < 0 else 0.0])})
        commands[episode.env, episode.number, episode.asked[-1]] = point, hand
        return steps

    return answer
