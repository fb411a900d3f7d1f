"""The authors' policy that only sees: two views side by side, upside down, bytes; it answers joint changes that add up."""

import numpy as np
from PIL import Image

from .network import Network

SIZE = 56


def network():
    return Network(steps=10, width=7, seed=41)


def panorama(scene, hand):
    """Scene at the left, hand at the right, each 56 x 56 and upside down: (56, 112, 3) uint8."""
    shrunk = [Image.fromarray(image[::-1, ::-1]).resize((SIZE, SIZE), Image.Resampling.BILINEAR) for image in (scene, hand)]
    return np.concatenate([np.asarray(one) for one in shrunk], axis=1)


def changes(net, scene, hand):
    """(10, 7): six changes in degrees, each counted from where the step before leads, and the gripper, 1 open, -1 closed."""
    raw = net(picture=panorama(scene, hand) / 255.0 - 0.5)
    return raw * np.array([1.5, 1.0, 1.2, 1.5, 2.0, 2.0, 1.0])
