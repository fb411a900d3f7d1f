def convert(:
    pass
