import cv2


def frames_of(path):
    video = cv2.VideoCapture(path)
    while True:
        ok, frame = video.read()
        if not ok:
            return
        yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)


def save(episode, writer):
    for image in episode["vision"]["cam_head"]["colors"]:
        bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        writer.write(bgr)
