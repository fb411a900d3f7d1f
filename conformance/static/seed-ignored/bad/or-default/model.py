class Model:
    def __init__(self, config):
        self.rng = make_generator(int(config.get("sample_seed") or config.get("seed") or 42))
