import cv2


def _decode_frames(packed):
    return [codec.unpack(one) for one in packed]


def film(episode, path):
    writer = cv2.VideoWriter(path, 0, 25, (320, 240))
    for frame in _decode_frames(episode["frames"]):
        writer.write(frame)
    writer.release()
