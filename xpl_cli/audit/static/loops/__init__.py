"""Evaluation loops, followed on their syntax trees beside the reference."""
