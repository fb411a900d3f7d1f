"""A change around an adapter: of what it is shown, of what it commands, or of both."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from xpl.contract import Observation, ObservationDict

Obs = Observation
Given = Mapping[str, np.ndarray]
"""An action step, or what was observed of the robot: numbers by key."""
Steps = list[dict[str, np.ndarray]]
Step = Given | None
"""An action step; None where a change cannot tell what it would be."""
Episode = list[ObservationDict]
"""Observations that are shown, oldest first."""
Shown = Callable[[Sequence[Obs]], Episode]
"""Returns what is shown instead of the observations of an episode, oldest first."""
Commanded = Callable[[Sequence[Sequence[Given]], Sequence[Obs], Sequence[int]], list[list[Step]]]
"""Returns what the answers of an episode become, of its true observations and the places of the questions in them."""


@dataclass(frozen=True)
class Signal:
    """One change around an adapter, in the standard's terms.

    With `shown` the episode is played again: as many observations, questions at the same places. Signals that share one
    `shown` share one play. If `windowed`, each question is an episode of its own: `shown` gets the observations up to
    the question, what it returns is shown, and the last is asked about.

    Attributes:
        rank: 0 for the likeliest.
        words: what the model means, where the adapter does otherwise: "unit: deg (state)".
        convention: of the vocabulary of reference.py.
        shown: of what the adapter is shown, or None.
        commanded: of what it answers, or None.
        windowed: whether each question is played alone.
    """

    rank: int
    words: str
    convention: str
    shown: Shown | None = None
    commanded: Commanded | None = None
    windowed: bool = False
