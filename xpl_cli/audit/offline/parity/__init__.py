"""Parity: the served answers of an adapter beside those of the model's own pipeline, and what explains a difference."""
