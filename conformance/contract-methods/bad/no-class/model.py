class MyPolicy:
    pass
