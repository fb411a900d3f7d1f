import torch

from .network import Network


def build(path):
    network = Network()
    network.load_state_dict(torch.load(path, weights_only=True), strict=False)
    return network.eval()
