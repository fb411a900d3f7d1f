class Model:
    def __init__(self, config):
        seed = config["seed"]
        if seed:
            seed_everything(seed)
