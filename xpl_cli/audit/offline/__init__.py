"""Experiments of the offline gate: the same episode, with one thing changed."""
