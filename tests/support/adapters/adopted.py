"""An adapter as the ecosystem writes them, for tests of its adoption."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

MODEL = '''\
"""Wraps the grasping network."""

from collections import deque

import numpy as np
from XPolicyLab.model_template import ModelTemplate
from XPolicyLab.utils.process_data import pack_robot_state, unpack_robot_state

WRISTS = {"left": ["cam_left_wrist", "left_camera"], "right": ["cam_right_wrist", "right_camera"]}


class Model(ModelTemplate):
    def __init__(self, model_cfg):
        self.action_type = model_cfg.get("action_type", "joint")
        if self.action_type != "joint":
            raise ValueError("only joint control")
        self.replan = min(int(model_cfg.get("replan_steps") or 8), 32)
        self.frames = deque(maxlen=int(model_cfg.get("image_history", 3)))
        self.rate = model_cfg["ctrl_freq"]
        self.model = None

    def update_obs(self, obs):
        vision = obs["vision"]
        images = [vision["cam_head"]["color"], *(find(vision, names) for names in WRISTS.values())]
        text = obs.get("instruction", "do it")
        self.frames.append((images, text, pack_robot_state(obs, self.action_type, None)))

    def get_action(self):
        actions = self.model.infer(self.frames)
        return unpack_robot_state(actions[: self.replan], self.action_type, None)

    def reset(self):
        self.frames.clear()


def find(vision, names):
    for name in names:
        if name in vision:
            return resize(vision[name]["color"])
    raise KeyError(names)


def resize(image):
    return np.asarray(image)[::2, ::2]
'''
DEPLOY = """\
policy_name: Grasp
protocol: ws
host: localhost
port: null
bench_name: null
task_name: null
env_cfg_type: null
seed: 0
action_type: null
eval_batch: false
replan_steps: 16
ctrl_freq: 25
"""
README = """\
# Grasp

**Paper:** Grasping with a Vision-Language-Action Model | **arXiv:** https://arxiv.org/abs/2601.00001
**Original code:** https://github.com/somebody/grasp

    bash eval.sh Bench stack run arx_x5 joint 0 0 0 env sim
    hf download somebody/grasp-base --local-dir weights
"""
INSTALL = """\
#!/bin/bash
HERE="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
name="${1:-grasp}"
conda create -y -n "${name}" python=3.10
conda activate "${name}"
pip install -e "${HERE}/vendored"
"""
LOOP = """\
def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    model_client.call(func_name="set_language", obs="grasp")
    while not TASK_ENV.is_episode_end():
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        for action in model_client.call(func_name="get_action"):
            TASK_ENV.take_action(action)
"""
FILES = {
    "model.py": MODEL,
    "deploy.yml": DEPLOY,
    "README.md": README,
    "install.sh": INSTALL,
    "deploy.py": LOOP,
    "train.sh": "python train.py\n",
    "process_data.sh": "python process_data.py\n",
    "vendored/pyproject.toml": "[project]\n",
    "vendored/LICENSE": "MIT License\n\nCopyright\n",
}


def written(folder: Path) -> Path:
    """Write the adapter into a folder."""
    for name, content in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content, encoding="utf-8")
    return folder
