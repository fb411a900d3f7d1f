import cv2

from XPolicyLab.utils.process_data import decode_image_bit


class Frames:
    def __getitem__(self, place):
        image = decode_image_bit(self.packed[place])
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
