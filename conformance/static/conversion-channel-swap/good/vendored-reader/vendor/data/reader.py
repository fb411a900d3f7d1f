import cv2

from XPolicyLab.utils.process_data import decode_image_bit


class Frames:
    def __getitem__(self, place):
        return decode_image_bit(self.packed[place])

    def still(self, path):
        return cv2.cvtColor(cv2.imread(path), cv2.COLOR_BGR2RGB)
