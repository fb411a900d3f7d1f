"""The authors' pipeline for two arms: three letterboxed views, joints in radians, fingers in metres, deltas."""

import numpy as np
from PIL import Image

from .network import Network

Q01 = np.array([-3.1, -0.1, -0.1, -1.6, -1.6, -2.0, 0.0] * 2)
Q99 = np.array([2.7, 3.4, 3.2, 1.6, 1.6, 2.0, 0.044] * 2)
ACTION_Q01 = np.array([-0.04, -0.05, -0.05, -0.06, -0.06, -0.07, 0.0] * 2)
ACTION_Q99 = np.array([0.05, 0.04, 0.06, 0.05, 0.07, 0.06, 0.044] * 2)
EPS = 1e-6
VIEWS = ("top", "left_wrist", "right_wrist")


def network():
    return Network(steps=8, width=14, seed=11)


def resize_with_pad(image, height=72, width=72):
    """openpi's: scale until it fits, black bars."""
    ratio = max(image.shape[1] / width, image.shape[0] / height)
    h, w = int(image.shape[0] / ratio), int(image.shape[1] / ratio)
    small = Image.fromarray(image).resize((w, h), Image.Resampling.BILINEAR)
    frame = Image.new("RGB", (width, height), 0)
    frame.paste(small, ((width - w) // 2, (height - h) // 2))
    return np.asarray(frame)


def sample(net, pictures, state, prompt):
    """pictures: by view, (H, W, 3) uint8 RGB; state (14,): left joints, left finger, right joints, right finger."""
    views = np.stack([resize_with_pad(pictures[name]) for name in VIEWS]).astype(np.float32) / 255.0 * 2.0 - 1.0
    normal = (state - Q01) / (Q99 - Q01 + EPS) * 2.0 - 1.0
    raw = net(images=views, state=normal, text=prompt)
    actions = (raw + 1.0) / 2.0 * (ACTION_Q99 - ACTION_Q01 + EPS) + ACTION_Q01
    actions[:, :6] += state[:6]
    actions[:, 7:13] += state[7:13]
    return actions
