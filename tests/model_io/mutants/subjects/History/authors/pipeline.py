"""The authors' policy with a memory of three pictures, two control steps apart; joints from the hand to the shoulder."""

import numpy as np
from PIL import Image

from .network import Network

FRAMES, STRIDE = 3, 2
MEAN = np.array([0.0, 0.8, 0.9, 0.1, -0.1, 0.0])  # from shoulder to hand
STD = np.array([1.1, 0.7, 0.6, 0.8, 0.7, 0.9])
GRIPPER = (0.0, 0.05)  # metres: closed, open


def network():
    return Network(steps=12, width=14, seed=67)


def frame(image):
    small = Image.fromarray(image).resize((64, 48), Image.Resampling.BILINEAR)
    return (np.asarray(small, np.float32) / 255.0).transpose(2, 0, 1)


def normal(arm, finger):
    """arm (6,) rad from shoulder to hand, finger in metres: (7,) from hand to shoulder, then the finger."""
    return np.append(((arm - MEAN) / STD)[::-1], 2 * finger / GRIPPER[1] - 1)


def timeline(items):
    """The newest of three is now; before the beginning there is the first."""
    return [items[max(0, len(items) - 1 - age * STRIDE)] for age in reversed(range(FRAMES))]


def act(net, pictures, states, text):
    """(12, 14): for the left arm, then the right, targets near the state, as normal() writes it."""
    now = states[-1]
    raw = net(pictures=np.stack(pictures), states=np.stack(states), text=f"Instruction: {text.strip()} Action:")
    rows = now + 0.05 * raw
    rows[:, [6, 13]] = raw[:, [6, 13]]
    return rows
