import numpy as np


def frames(data, steps):
    if "cam_head" not in data["vision"]:
        raise KeyError("no cam_head in the recording")
    images = {"cam_head": data["vision"]["cam_head"]["colors"]}
    if "cam_wrist" in data["vision"]:
        images["cam_wrist"] = data["vision"]["cam_wrist"]["colors"]
    else:
        images["cam_wrist"] = np.zeros((steps, 240, 320, 3), dtype=np.uint8)
        images["cam_wrist_mask"] = np.zeros(steps, dtype=bool)
    return images


def next_state(data, action):
    state = data["state"]
    action["pose"] = state["ee_poses"][1:]
    return action
