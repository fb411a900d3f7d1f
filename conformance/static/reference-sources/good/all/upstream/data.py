KEYS = ("left", "right")
DELTA = True
