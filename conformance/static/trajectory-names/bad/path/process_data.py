def actions(root, side):
    poses = [root["action/left_ee_pose"][()], root[f"/state/{side}_ee_poses"][()]]
    for camera in root["vision"].values():
        poses.append(camera["depth"])
    return poses
