"""The authors' recurrent policy for one arm: degrees, two joints turned the other way, a cropped picture, a hidden state."""

import numpy as np
from PIL import Image

from .network import Network

SIGN = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
ZERO = np.array([0.0, 90.0, -90.0, 0.0, 0.0, 0.0])  # degrees, of the authors' own zero
GRIPPER_CLOSED, GRIPPER_OPEN = 100.0, 0.0
HIDDEN = 12


class Agent:
    def __init__(self):
        self.network = Network(steps=4, width=7, seed=31)
        self.cell = np.random.default_rng(5).normal(size=(HIDDEN, HIDDEN)) / np.sqrt(HIDDEN)
        self.into = np.random.default_rng(6).normal(size=(7, HIDDEN)) / np.sqrt(7)

    def begin(self):
        return np.zeros(HIDDEN)

    def step(self, hidden, image, joints, prompt):
        """image (60, 60, 3) float 0..1, joints (7,) degrees and gripper percent: (4, 7), and the next hidden state."""
        hidden = np.tanh(hidden @ self.cell + (joints / 90.0) @ self.into)
        return self.network(image=image, joints=joints / 90.0, hidden=hidden, text=prompt), hidden


def crop(image):
    """The middle four fifths, then 60 x 60."""
    height, width = image.shape[:2]
    h, w = int(height * 0.8), int(width * 0.8)
    top, left = (height - h) // 2, (width - w) // 2
    small = Image.fromarray(image[top : top + h, left : left + w]).resize((60, 60), Image.Resampling.LANCZOS)
    return np.asarray(small, np.float32) / 255.0


def prompt(text):
    return "What should the robot do to " + text.strip().lower() + "?"
