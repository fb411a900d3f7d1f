def frames(episode):
    found = []
    for camera in episode["vision"].values():
        found.append(camera["colors"])
    return found, episode["state"]["arm_joint_states"], episode["action"]["left_ee_poses"]


def either(camera, data):
    image = data["vision"][camera]
    return image["colors"] if "colors" in image else image["color"]


def written(data):
    row = {"observation.state": data["state"]["arm_joint_states"], "color": 1}
    return row["color"], data["state"]["torso_height"]
