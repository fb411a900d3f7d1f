"""Answers through the authors' own pipeline."""

import numpy as np

from .authors import pipeline

CONVENTIONS = {
    "image_channels": "authors/pipeline.py:33",
    "image_size": "authors/pipeline.py:20",
    "image_filter": "authors/pipeline.py:24",
    "image_range": "authors/pipeline.py:32",
    "camera": "authors/pipeline.py:13",
    "joint_order": "authors/pipeline.py:31",
    "angle_unit": "authors/pipeline.py:8",
    "gripper": "authors/pipeline.py:9",
    "action_reference": "authors/pipeline.py:36",
    "normalization": "authors/pipeline.py:33",
    "instruction": "assumed: the authors hand the text on",
    "chunk": "authors/pipeline.py:16",
}
FINGER = 0.044


def answers(config):
    net = pipeline.network()

    def answer(episode):
        now = episode.observations[-1]
        color = {name: view["color"] for name, view in now["vision"].items()}
        body = now["state"]
        state = np.concatenate(
            [
                np.asarray(body[f"{side}_{key}_joint_state"], np.float64) * scale
                for side in ("left", "right")
                for key, scale in (("arm", 1.0), ("ee", FINGER))
            ]
        )
        pictures = {
            "top": color["cam_head"],
            "left_wrist": color["cam_left_wrist"],
            "right_wrist": color["cam_right_wrist"],
        }
        rows = pipeline.sample(net, pictures, state, now["instruction"])
        return [
            {
                "left_arm_joint_state": row[:6],
                "left_ee_joint_state": np.clip(row[6:7] / FINGER, 0, 1),
                "right_arm_joint_state": row[7:13],
                "right_ee_joint_state": np.clip(row[13:14] / FINGER, 0, 1),
            }
            for row in rows
        ]

    return answer
