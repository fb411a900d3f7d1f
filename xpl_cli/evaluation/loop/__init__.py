"""Evaluation loops of adapters, in processes of their own: the side that judges them."""
