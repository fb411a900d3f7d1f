"""Checkpoints of policy.yml: fetch them, and verify their digests."""
