"""Adapter of Tiny_VLA. It imports nothing, so that simulators can import deploy.py alone."""
