"""Closed loops in MuJoCo, and what is measured in them."""
