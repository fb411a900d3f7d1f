import cv2


def images(episode):
    frames = []
    for frame in decode(episode["vision"]["cam_head"]["colors"]):
        frame = cv2.resize(frame, (320, 240))
        frames.append(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
    return frames
