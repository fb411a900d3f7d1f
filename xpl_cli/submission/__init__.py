"""Submissions: a run as a bundle that third parties can check and replay."""
