"""The authors' pipeline for one arm: two observations, fingertip poses in the arm's base, BGR pictures."""

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from .network import Network

MEAN = np.array([0.406, 0.456, 0.485])  # of BGR
STD = np.array([0.225, 0.224, 0.229])
HORIZON = 2
# The base in the world, and the fingertips in the flange.
BASE = np.array([0.0, -0.55, 0.765])
BASE_TURN = Rotation.from_euler("z", 90, degrees=True)
TIP = np.array([0.0, 0.0, 0.1034])
TIP_TURN = Rotation.from_euler("z", -45, degrees=True)
CENTRE = np.array([0.35, 0.0, 0.45])
REACH = 0.8


def network():
    return Network(steps=6, width=7, seed=23)


def picture(image, turned):
    image = image[..., ::-1]  # OpenCV reads blue first
    if turned:
        image = image[::-1, ::-1]
    small = Image.fromarray(np.ascontiguousarray(image)).resize((64, 64), Image.Resampling.BICUBIC)
    return ((np.asarray(small, np.float32) / 255.0 - MEAN) / STD).transpose(2, 0, 1)


def tip(flange):
    """flange: position, quaternion w x y z in the world. Position and Rotation of the fingertips in the base."""
    turn = Rotation.from_quat(np.roll(flange[3:], -1))
    place = flange[:3] + turn.apply(TIP)
    return BASE_TURN.inv().apply(place - BASE), BASE_TURN.inv() * turn * TIP_TURN


def flange(place, turn):
    world = BASE_TURN * turn * TIP_TURN.inv()
    return np.concatenate([BASE_TURN.apply(place) + BASE - world.apply(TIP), np.roll(world.as_quat(), 1)])


def state_vector(place, turn, opening):
    """Position, two rows of the rotation matrix, both fingers in metres."""
    rows = turn.as_matrix()[:2].ravel()
    return np.concatenate([(place - CENTRE) / REACH, rows, [0.04 * opening, -0.04 * opening]])


def act(net, heads, wrists, states, place, turn):
    """Answer: change of position in the base, change of rotation as axis-angle in the base, gripper: 1 closes."""
    raw = net(head=np.stack(heads), wrist=np.stack(wrists), state=np.stack(states))
    steps = []
    for row in raw:
        moved = place + 0.02 * row[:3]
        turned = Rotation.from_rotvec(0.06 * row[3:6]) * turn
        steps.append((flange(moved, turned), (1.0 - row[6]) / 2.0))
    return steps
