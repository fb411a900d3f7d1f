"""Answers through the authors' own agent."""

import numpy as np

from .authors import pipeline

CONVENTIONS = {
    "image_channels": "authors/pipeline.py:31",
    "image_size": "authors/pipeline.py:33",
    "image_filter": "authors/pipeline.py:37",
    "image_range": "authors/pipeline.py:38",
    "camera": "assumed",
    "joint_order": "authors/pipeline.py:8",
    "angle_unit": "authors/pipeline.py:9",
    "gripper": "authors/pipeline.py:10",
    "action_reference": "authors/pipeline.py:25",
    "instruction": "authors/pipeline.py:42",
    "recurrent": "authors/pipeline.py:26",
    "normalization": "authors/pipeline.py:27",
    "chunk": "authors/pipeline.py:16",
}


def joints_of(obs):
    angles = np.degrees(np.asarray(obs["state"]["arm_joint_state"], np.float64)) * pipeline.SIGN + pipeline.ZERO
    percent = 100.0 * (1.0 - float(obs["state"]["ee_joint_state"][0]))
    return np.append(angles, percent)


def answers(config):
    agent = pipeline.Agent()

    def answer(episode):
        hidden = agent.begin()
        for place in episode.asked:
            obs = episode.observations[place]
            joints = joints_of(obs)
            image = pipeline.crop(obs["vision"]["cam_head"]["color"])
            rows, hidden = agent.step(hidden, image, joints, pipeline.prompt(obs["instruction"]))
        steps = []
        for row in rows:
            target = joints[:6] + 2.0 * row[:6]
            angles = np.radians((target - pipeline.ZERO) * pipeline.SIGN)
            steps.append({"arm_joint_state": angles, "ee_joint_state": np.array([0.5 - 0.5 * row[6]])})
        return steps

    return answer
