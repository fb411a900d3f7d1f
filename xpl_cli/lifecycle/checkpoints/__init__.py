"""Checkpoints that policy.yml specifies: brought from where they are, checked by digest, kept by content."""
