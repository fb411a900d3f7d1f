import cv2


def decode_image(data):
    return cv2.cvtColor(cv2.imdecode(data, 1), cv2.COLOR_BGR2RGB)
