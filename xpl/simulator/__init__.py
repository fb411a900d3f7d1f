"""Environments in separate processes, and what their parent needs to drive them."""
