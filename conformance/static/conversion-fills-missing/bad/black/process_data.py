import numpy as np


def frames(data, steps):
    images, vision = {}, data["vision"]
    for camera in ("cam_head", "cam_wrist"):
        if camera not in vision:
            images[camera] = np.zeros((steps, 240, 320, 3), dtype=np.uint8)
            continue
        images[camera] = data["vision"][camera]["colors"]
    return images
