class Model:
    def __init__(self, config):
        self.seed = int(config.get("seed", 0))
        self.network = build(config["ckpt_name"])
