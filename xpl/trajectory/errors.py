"""What goes wrong with trajectories."""

from __future__ import annotations


class TrajectoryError(ValueError):
    """A trajectory cannot be read or written; the text names file and dataset, what was expected and what came."""
