"""Checkpoints and data sets that training left behind: what they say of the model, each fact with its place."""
