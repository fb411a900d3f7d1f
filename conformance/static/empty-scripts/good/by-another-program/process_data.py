import os


class Converter:
    def convert(self):
        raise NotImplementedError("not this kind")


def main():
    if os.system("lerobot-convert"):
        raise RuntimeError("failed")


main()
