"""Parity: the adapter's actions compared with those of the reference, and what explains a difference."""
