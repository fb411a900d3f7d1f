"""A usual mistake of an adapter, by the change that undoes it: of the block, of what is shown, read or commanded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Optional, Union

import numpy as np

from xpl.contract import Entry, Observation, ObservationDict

if TYPE_CHECKING:
    from pathlib import Path

    from xpl.embodiment import Embodiment

Obs = Observation
Given = Mapping[str, np.ndarray]
"""An action step, or what was observed of the robot: numbers by key."""
Steps = list[dict[str, np.ndarray]]
Step = Optional[Given]
"""An action step; None where a change cannot tell what it would be."""
Episode = list[ObservationDict]
"""Observations that are shown, oldest first."""
Shown = Callable[[Sequence[Obs]], Episode]
"""Returns what is shown instead of the observations of an episode, oldest first."""
Commanded = Callable[[Sequence[Sequence[Given]], Sequence[Obs], Sequence[int]], list[list[Step]]]
"""Returns what the answers of an episode become, of its true observations and the places of the questions in them."""
Place = tuple[Union[str, int], ...]
"""Keys and positions that lead to a value of the block."""


@dataclass(frozen=True)
class Mistake:
    """One mistake, by what undoes it. It is applied in one of four ways: `edits`, `encoded`, or around the adapter.

    Around an adapter, `shown` changes the observations, and the episode is played again: as many observations,
    questions at the same places. Mistakes that share one `shown` share one play. If `windowed`, each question is an
    episode of its own: `shown` gets the observations up to the question, what it returns is shown, and the last is
    asked about. `commanded` changes the answers, and asks the model nothing.

    Attributes:
        rank: 0 for the likeliest.
        words: what the model means, where the adapter does otherwise: "unit: deg (state)".
        convention: its name.
        edits: of the block: by place the new value; `edits.GONE` takes it out.
        encoded: of what the adapter's own `encode` makes, as `xpl.worker.encoded.play` takes it.
        geometry: of pictures of another size, all but the filter; "" for other mistakes.
        shown: of what the adapter is shown, or None.
        commanded: of what it answers, or None.
        windowed: whether each question is played alone.
    """

    rank: int
    words: str
    convention: str
    edits: Mapping[Place, Any] | None = field(default=None, hash=False)
    encoded: Entry | None = field(default=None, hash=False)
    geometry: str = ""
    shown: Shown | None = None
    commanded: Commanded | None = None
    windowed: bool = False


@dataclass(frozen=True)
class Case:
    """What is known of an adapter whose mistake is looked for.

    Attributes:
        embodiment: the robot.
        action_type: joint or ee.
        block: its model_io block; empty where it has none.
        folders: where files of statistics may lie.
        templates: of instructions that its authors' code writes.
        cameras: that it reads; none where it reads no pictures.
        reads: fields of the state that it reads, without an arm's prefix; None where that is not known.
        history: observations that it keeps.
        stride: control steps between them.
        instructions: texts of the scripted episodes; none where it reads no text.
    """

    embodiment: Embodiment
    action_type: str
    block: Entry = field(default_factory=dict)
    folders: Sequence[Path] = ()
    templates: Sequence[str] = ()
    cameras: Sequence[str] = ()
    reads: Sequence[str] | None = None
    history: int = 1
    stride: int = 1
    instructions: Sequence[str] = ()
