"""The authors' diffusion policy for two arms: it draws noise; right arm first, quaternions x y z w, grippers reversed."""

import cv2
import numpy as np

from .network import Network

LOW = np.array([-0.9, -0.9, 0.0])
HIGH = np.array([0.9, 0.9, 1.6])
STEPS, WIDTH = 6, 16


def network():
    return Network(steps=STEPS, width=WIDTH, seed=53)


def pixels(image):
    """(3, 24, 32) float32, 0..1, of the smaller picture (24, 32): the area of each pixel."""
    small = cv2.resize(image, (32, 24), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32).transpose(2, 0, 1) / 255.0


def place(position):
    return np.clip(2.0 * (position - LOW) / (HIGH - LOW) - 1.0, -1.0, 1.0)


def observe(arms):
    """arms: (position, quaternion x y z w with w >= 0, closing 0..1) of the right arm, then of the left: (16,)."""
    return np.concatenate([np.concatenate([place(p), q, [c]]) for p, q, c in arms])


def sample(net, views, state, noise):
    """(6, 16): for each arm change of position / 0.03, change of quaternion x y z / 0.05 and 0, closing."""
    return net(views=np.stack(views), state=state, noise=0.3 * noise)
