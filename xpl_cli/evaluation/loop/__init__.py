"""Evaluation loops of adapters, played in processes of their own: the judge's side."""
