import torch


class Model:
    def __init__(self, config):
        seed = config.get("seed")
        self.seed = 0 if seed is None else int(seed)
        self.offset = config.get("seed") or 0
        self.generator = torch.Generator().manual_seed(self.seed)

    def get_action(self):
        return torch.randn(14, generator=self.generator)
