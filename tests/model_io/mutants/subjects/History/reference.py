"""Answers through the authors' own pipeline."""

import numpy as np

from .authors import pipeline

CONVENTIONS = {
    "image_channels": "assumed",
    "image_size": "authors/pipeline.py:20",
    "image_filter": "authors/pipeline.py:20",
    "image_range": "authors/pipeline.py:21",
    "camera": "assumed",
    "joint_order": "authors/pipeline.py:26",
    "angle_unit": "authors/pipeline.py:25",
    "gripper": "authors/pipeline.py:12",
    "action_reference": "authors/pipeline.py:35",
    "history_length": "authors/pipeline.py:7",
    "history_order": "authors/pipeline.py:31",
    "history_padding": "authors/pipeline.py:31",
    "history_stride": "authors/pipeline.py:7",
    "instruction": "authors/pipeline.py:37",
    "normalization": "authors/pipeline.py:10",
    "chunk": "authors/pipeline.py:16",
}
SIDES = ("left", "right")


def answers(config):
    net = pipeline.network()

    def state_of(obs):
        told = obs["state"]
        return np.concatenate(
            [
                pipeline.normal(
                    np.asarray(told[f"{side}_arm_joint_state"], np.float64),
                    pipeline.GRIPPER[1] * float(told[f"{side}_ee_joint_state"][0]),
                )
                for side in SIDES
            ]
        )

    def answer(episode):
        seen = pipeline.timeline(episode.observations)
        pictures = [pipeline.frame(obs["vision"]["cam_head"]["color"]) for obs in seen]
        rows = pipeline.act(net, pictures, [state_of(obs) for obs in seen], seen[-1]["instruction"])
        steps = []
        for row in rows:
            step = {}
            for side, part in zip(SIDES, (row[:7], row[7:])):
                step[f"{side}_arm_joint_state"] = part[:6][::-1] * pipeline.STD + pipeline.MEAN
                step[f"{side}_ee_joint_state"] = np.clip(np.array([(part[6] + 1) / 2]), 0, 1)
            steps.append(step)
        return steps

    return answer
