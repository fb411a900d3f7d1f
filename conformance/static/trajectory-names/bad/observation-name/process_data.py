import h5py


def frames(path):
    with h5py.File(path) as episode:
        vision = episode["vision"]
        head = vision["cam_head"]
        return head["color"][()], episode["state"].get("arm_joint_state")
