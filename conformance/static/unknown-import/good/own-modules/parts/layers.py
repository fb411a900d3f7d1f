from dataclasses import dataclass as Plain


class Layer:
    pass
