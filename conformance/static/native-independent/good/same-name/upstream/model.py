class Theirs:
    pass
