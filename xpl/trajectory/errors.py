"""Errors of trajectories."""

from __future__ import annotations


class TrajectoryError(ValueError):
    """A trajectory cannot be read or written; the text names file and dataset, and what was expected."""
