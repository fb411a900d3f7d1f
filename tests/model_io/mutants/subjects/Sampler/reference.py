"""Answers through the authors' own pipeline."""

import numpy as np
from scipy.spatial.transform import Rotation

from .authors import pipeline

CONVENTIONS = {
    "image_channels": "assumed",
    "image_size": "authors/pipeline.py:20",
    "image_filter": "authors/pipeline.py:20",
    "image_range": "authors/pipeline.py:21",
    "camera": "assumed",
    "rotation": "authors/pipeline.py:29",
    "frame": "assumed: the world",
    "point": "assumed: the flange",
    "joint_order": "authors/pipeline.py:29",
    "gripper": "authors/pipeline.py:29",
    "action_reference": "authors/pipeline.py:34",
    "normalization": "authors/pipeline.py:25",
    "sampling": "authors/pipeline.py:35",
    "chunk": "authors/pipeline.py:10",
}
SIDES = ("right", "left")


def answers(config):
    net = pipeline.network()

    def answer(episode):
        now = episode.observations[-1]
        views = [pipeline.pixels(now["vision"][f"cam_{name}"]["color"]) for name in ("head", "right_wrist", "left_wrist")]
        poses = {side: np.asarray(now["state"][f"{side}_ee_pose"], np.float64) for side in SIDES}
        arms = []
        for side in SIDES:
            w, x, y, z = poses[side][3:]
            quaternion = np.array([x, y, z, w]) * (1.0 if w >= 0 else -1.0)
            arms.append((poses[side][:3], quaternion, 1.0 - float(now["state"][f"{side}_ee_joint_state"][0])))
        noise = episode.rng.standard_normal((pipeline.STEPS, pipeline.WIDTH))
        rows = pipeline.sample(net, views, pipeline.observe(arms), noise).astype(np.float64)
        steps = []
        for row in rows:
            step = {}
            for side, part in zip(SIDES, (row[:8], row[8:])):
                turn = Rotation.from_rotvec(0.1 * part[3:6]) * Rotation.from_quat(np.roll(poses[side][3:], -1))
                place = poses[side][:3] + 0.03 * part[:3]
                step[f"{side}_ee_pose"] = np.concatenate([place, np.roll(turn.as_quat(canonical=True), 1)])
                step[f"{side}_ee_joint_state"] = np.array([(1.0 - part[7]) / 2.0])
            steps.append(step)
        return steps

    return answer
