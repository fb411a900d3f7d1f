"""Answers as the authors' rollout does."""

import numpy as np

from .network import Network

CONVENTIONS = {
    "image_channels": "authors/rollout.py:12",
    "image_range": "authors/rollout.py:13",
    "gripper": "authors/dataset.py:40",
    "action_reference": "authors/dataset.py:55",
    "joint_order": "assumed: the authors number them",
    "angle_unit": "assumed",
}
SPAN = np.pi


def answers(config):
    network = Network()

    def answer(episode):
        now = episode.observations[-1]
        image = now["vision"]["cam_head"]["color"][1::2, 1::2, ::-1] / 127.5 - 1
        joints = np.asarray(now["state"]["arm_joint_state"], np.float64)
        finger = 0.04 * float(now["state"]["ee_joint_state"][0])
        state = np.concatenate([joints / SPAN, [2 * finger / 0.04 - 1]]).astype(np.float32)
        prompt = "Task: " + now["instruction"].strip(" ").lower()
        said = network(image.astype(np.float32), state, prompt)
        steps = []
        for row in said:
            opening = np.clip((row[7] + 1) / 2, 0, 1)
            steps.append({
                "arm_joint_state": (joints + 0.1 * row[:7]).astype(np.float32),
                "ee_joint_state": np.array([opening], np.float32),
            })
        return steps

    return answer
