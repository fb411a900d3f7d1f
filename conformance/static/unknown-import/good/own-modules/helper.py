import sys

if sys.platform == "linux":
    CHOSEN = 1
else:
    CHOSEN = 2

try:
    import torch as found
except ImportError:
    found = None

for count in range(3):
    pass


def fill():
    global later
    later = 1
