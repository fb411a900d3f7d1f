"""Rollouts in MuJoCo, and their measurements."""
