"""Adapter of demo_policy. It imports nothing, so that simulators can import deploy.py alone."""
