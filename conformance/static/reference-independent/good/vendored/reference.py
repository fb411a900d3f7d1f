"""Answers of the model, unlike model.py through the code in upstream/."""

import importlib.util
import os
import sys
from pathlib import Path

import numpy as np

from .network import forward

CONVENTIONS = {"image_channels": "upstream/model.py:1", "gripper": "assumed: policy.yml has it from here"}
HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "upstream"))


def answers(config):
    spec = importlib.util.spec_from_file_location("theirs", HERE / "upstream" / "model.py")
    theirs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(theirs)
    other = os.path.join(config["repository"], "model.py")

    def answer(episode):
        return forward(theirs, other, np.zeros(3))

    return answer
