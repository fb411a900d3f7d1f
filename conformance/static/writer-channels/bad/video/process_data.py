import cv2


def video(episode, path):
    writer = cv2.VideoWriter(path, 0, 30, (640, 480))
    for frame in episode["vision"]["cam_head"]["colors"]:
        writer.write(frame)
