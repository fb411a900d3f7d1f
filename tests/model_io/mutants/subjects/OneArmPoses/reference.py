"""Answers through the authors' own pipeline."""

import numpy as np

from .authors import pipeline

CONVENTIONS = {
    "image_channels": "authors/pipeline.py:29",
    "image_orientation": "authors/pipeline.py:31",
    "image_size": "authors/pipeline.py:32",
    "image_filter": "authors/pipeline.py:32",
    "image_range": "authors/pipeline.py:33",
    "camera": "assumed",
    "rotation": "authors/pipeline.py:50",
    "point": "authors/pipeline.py:39",
    "frame": "authors/pipeline.py:40",
    "gripper": "authors/pipeline.py:51",
    "action_reference": "authors/pipeline.py:59",
    "history_length": "authors/pipeline.py:11",
    "history_order": "assumed",
    "history_padding": "assumed",
    "history_stride": "assumed",
    "normalization": "authors/pipeline.py:51",
    "chunk": "authors/pipeline.py:23",
}


def answers(config):
    net = pipeline.network()

    def answer(episode):
        seen = episode.observations[-pipeline.HORIZON :]
        seen = [seen[0]] * (pipeline.HORIZON - len(seen)) + seen
        heads, wrists, states = [], [], []
        for obs in seen:
            heads.append(pipeline.picture(obs["vision"]["cam_head"]["color"], turned=False))
            wrists.append(pipeline.picture(obs["vision"]["cam_wrist"]["color"], turned=True))
            place, turn = pipeline.tip(np.asarray(obs["state"]["ee_pose"], np.float64))
            states.append(pipeline.state_vector(place, turn, float(obs["state"]["ee_joint_state"][0])))
        steps = pipeline.act(net, heads, wrists, states, place, turn)
        return [{"ee_pose": pose, "ee_joint_state": np.array([opening])} for pose, opening in steps]

    return answer
