"""A common mistake of an adapter, as the change that undoes it: of block, observations, model inputs or actions."""

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
ArrayMap = Mapping[str, np.ndarray]
"""An action step, or an observed robot state: arrays by key."""
Steps = list[dict[str, np.ndarray]]
OptionalStep = Optional[ArrayMap]
"""An action step; None where a change cannot determine it."""
ObservationList = list[ObservationDict]
"""Observations that are sent to the policy, oldest first."""
ObservationChange = Callable[[Sequence[Obs]], ObservationList]
"""Returns the observations to send in place of those of an episode, oldest first."""
ActionChange = Callable[[Sequence[Sequence[ArrayMap]], Sequence[Obs], Sequence[int]], list[list[OptionalStep]]]
"""Returns changed answers of an episode, given the answers, the observations and the observation index of each call."""
BlockPath = tuple[Union[str, int], ...]
"""Keys and indices that lead to a value of the block."""


@dataclass(frozen=True)
class Mistake:
    """One mistake, as the change that undoes it: `edits`, `input_change`, or changes of observations and actions.

    `change_observations` changes the observations, and the episode is run again with calls at the same indices.
    Mistakes that share one `change_observations` share one rollout. If `windowed`, each call is an episode by itself:
    `change_observations` gets the observations up to the call, the policy is sent what it returns, and answers the
    last. `change_actions` changes the answers and needs no inference.

    Attributes:
        rank: 0 for the likeliest.
        description: what the model expects and the adapter does not: "unit: deg (state)".
        convention: name of its convention.
        edits: new values of the block by path; `edits.REMOVE` removes one.
        input_change: change of the inputs that the adapter's `encode` returns, as `xpl.worker.encoded.play` takes it.
        geometry: of images of another size, all but the filter; "" for other mistakes.
        change_observations: change of the observations, or None.
        change_actions: change of the answers, or None.
        windowed: whether each call is run as an episode by itself.
    """

    rank: int
    description: str
    convention: str
    edits: Mapping[BlockPath, Any] | None = field(default=None, hash=False)
    input_change: Entry | None = field(default=None, hash=False)
    geometry: str = ""
    change_observations: ObservationChange | None = None
    change_actions: ActionChange | None = None
    windowed: bool = False


@dataclass(frozen=True)
class AdapterCase:
    """Facts about an adapter whose mistake is searched.

    Attributes:
        embodiment: the robot.
        action_type: joint or ee.
        block: its model_io block; empty if it has none.
        folders: folders of statistics files.
        templates: templates of instructions in its authors' code.
        cameras: cameras that it reads.
        reads: fields of the state that it reads, without an arm's prefix; None if unknown.
        history: number of observations in its history.
        stride: control steps between them.
        instructions: texts of the scripted episodes; empty if it reads no text.
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
