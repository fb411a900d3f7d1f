import torch

TABLE = torch.load("table.pt")
