"""Errors of predicted actions: part by part, in the robot's units and as shares of the spread."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import _spec as sdk
from xpl import rotation

if TYPE_CHECKING:
    from xpl.contract import Action, State
    from xpl_cli.audit.offline.demonstrations.episodes import RecordedSession

Chunks = Mapping[int, "Sequence[Action | None]"]
"""Action steps by number of a question; None for steps that are not known."""

_FLOOR: Final = 0.1
"""Least spread of a number, as a share of the largest spread in its part."""
_MOST: Final = 3.0
"""Largest error, in spreads: errors are clipped, so that one outlier does not decide."""
_TURN: Final = slice(sdk.POSITION_DIM, sdk.POSE_DIM)


@dataclass(frozen=True)
class ActionPart:
    """Numbers of an action whose errors are averaged.

    Attributes:
        name: for people.
        unit: of its errors.
    """

    name: str
    unit: str


JOINTS = ActionPart("arm joints", "rad")
POSITION = ActionPart("position", "m")
ROTATION = ActionPart("rotation", "rad")
GRIPPER = ActionPart("gripper", "of its opening")
HAND = ActionPart("hand", "rad")


@dataclass(frozen=True)
class ActionErrors:
    """Errors of some questions, NaN where nothing is known.

    Attributes:
        parts: of each column, which part it is of.
        values: (questions, horizon, columns) in the parts' units.
        shares: the same, as shares of what each column spreads over; at most `_MOST`.
    """

    parts: tuple[ActionPart, ...]
    values: np.ndarray
    shares: np.ndarray

    def units(self, like: ActionErrors | None = None) -> dict[ActionPart, float]:
        """Return the mean error of each part in its unit, restricted to the steps where another's is known."""
        is_known = self.known if like is None else self.known & like.known
        errors = {}
        for part in dict.fromkeys(self.parts):
            chosen = self.values[..., [one == part for one in self.parts]].mean(-1)[is_known]
            chosen = chosen[np.isfinite(chosen)]  # what was refused has no value
            errors[part] = float(chosen.mean()) if chosen.size else float("nan")
        return errors

    @cached_property
    def known(self) -> np.ndarray:
        """(questions, horizon) bool: the steps of which everything is known."""
        known: np.ndarray = np.isfinite(self.shares).all(-1)
        return known

    @cached_property
    def steps(self) -> np.ndarray:
        """(questions, horizon): the mean over the parts of their mean share, NaN where it is not known."""
        each = [self.shares[..., [one == part for one in self.parts]].mean(-1) for part in dict.fromkeys(self.parts)]
        total: np.ndarray = np.mean(each, axis=0)
        return total


class ErrorMetric:
    """Measures chunks against the demonstrated actions of a session.

    Args:
        session: the recorded episodes with their questions.
    """

    def __init__(self, session: RecordedSession) -> None:
        self.session = session
        self._demonstrated = [session.chunk(question) for question in session.questions]
        self.horizon = max(map(len, self._demonstrated))
        self._keys = list(self._demonstrated[0][0])

    def errors(self, answers: Chunks, questions: Sequence[int], refused: Collection[int] = ()) -> ActionErrors:
        """Return the errors of the answers to some questions.

        Args:
            answers: the answers; a question without one is unknown, ...
            questions: numbers of the questions.
            refused: ... or counts with the largest error, if it is among these.
        """
        columns = [column for key in self._keys for column in self._columns(key)]
        predicted = {
            key: np.full((len(questions), self.horizon, len(self._demonstrated[0][0][key])), np.nan)
            for key in self._keys
        }
        demonstrated = {key: values[list(questions)] for key, values in self._stacked.items()}
        for row, number in enumerate(questions):
            for step, one in enumerate((answers.get(number) or ())[: self.horizon]):
                for key, values in predicted.items():
                    if one is not None and key in one and np.shape(one[key]) == values.shape[2:]:
                        values[row, step] = one[key]
        values = np.concatenate([_distances(key, predicted[key], demonstrated[key]) for key in self._keys], axis=-1)
        shares = np.minimum(values / self._spread, _MOST)
        for row, number in enumerate(questions):
            if number in refused:
                shares[row, : len(self._demonstrated[number])] = _MOST
        return ActionErrors(tuple(columns), values, shares)

    @cached_property
    def _stacked(self) -> dict[str, np.ndarray]:
        """Demonstrated actions by key, (questions, horizon, width), NaN after an episode's end."""
        stacks = {}
        for key in self._keys:
            stacks[key] = np.full((len(self._demonstrated), self.horizon, len(self._demonstrated[0][0][key])), np.nan)
            for number, chunk in enumerate(self._demonstrated):
                stacks[key][number, : len(chunk)] = [one[key] for one in chunk]
        return stacks

    @cached_property
    def _spread(self) -> np.ndarray:
        """(columns,): spread of each column in the episodes, at least the floor of its part."""
        spreads = []
        for key in self._keys:
            rows = np.concatenate([one.commanded[key] for one in self.session.recordings])
            middle = np.median(rows, axis=0)
            if key.endswith(sdk.State.EE_POSE):
                middle[_TURN] = rotation.normalise(rows[len(rows) // 2, _TURN])
            spreads.append(_distances(key, rows, np.broadcast_to(middle, rows.shape)).mean(0))
        spread = np.concatenate(spreads)
        columns = [column for key in self._keys for column in self._columns(key)]
        for part in set(columns):
            chosen = [one == part for one in columns]
            spread[chosen] = np.maximum(spread[chosen], _FLOOR * spread[chosen].max() or 1.0)
        return spread

    def _columns(self, key: str) -> list[ActionPart]:
        width = len(self._demonstrated[0][0][key])
        if key.endswith(sdk.State.EE_POSE):
            return [*[POSITION] * sdk.POSITION_DIM, ROTATION]
        if key.endswith(sdk.State.ARM_JOINT_STATE):
            return [JOINTS] * width
        return [GRIPPER if width == 1 else HAND] * width

    # -- baselines -----------------------------------------------------------------------------------------------------

    def hold_pose(self) -> Chunks:
        """Return the baseline that holds the pose of each question."""
        return {number: [self._state(*at)] * self.horizon for number, at in enumerate(self.session.question_steps)}

    def repeat_action(self) -> Chunks:
        """Return the baseline that repeats the action before each question; at the first step, it holds the pose."""
        chunks = {}
        for number, (episode, step) in enumerate(self.session.question_steps):
            rows = self.session.recordings[episode].commanded
            action = {key: values[step - 1] for key, values in rows.items()} if step else self._state(episode, step)
            chunks[number] = [action] * self.horizon
        return chunks

    def motion_share(self, answers: Chunks, questions: Sequence[int]) -> float:
        """Return the commanded motion of arms as a share of the demonstrated motion; NaN where nothing is known."""
        still, moved = self.hold_pose(), [0.0, 0.0]
        for number in questions:
            for predicted, demonstrated, start in zip(
                answers.get(number) or (), self._demonstrated[number], still[number], strict=False
            ):
                if predicted is None or start is None:
                    continue
                for key in (key for key in self._keys if not key.endswith(sdk.State.EE_JOINT_STATE)):
                    moved[0] += float(np.abs(np.asarray(predicted[key]) - start[key]).sum())
                    moved[1] += float(np.abs(np.asarray(demonstrated[key]) - start[key]).sum())
        return moved[0] / moved[1] if moved[1] > 0 else float("nan")

    def _state(self, episode: int, step: int) -> State:
        return {key: values[step] for key, values in self.session.recordings[episode].state.items()}


def _distances(key: str, predicted: np.ndarray, demonstrated: np.ndarray) -> np.ndarray:
    """Return distances of rows (..., width) of one key: by number; of poses three coordinates and one angle."""
    if not key.endswith(sdk.State.EE_POSE):
        distances: np.ndarray = np.abs(predicted - demonstrated)
        return distances
    one, other = predicted[..., _TURN], demonstrated[..., _TURN]
    lengths = np.linalg.norm(one, axis=-1) * np.linalg.norm(other, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = 2.0 * np.arccos(np.clip(np.abs((one * other).sum(-1)) / lengths, 0.0, 1.0))
    positions = np.abs(predicted[..., : sdk.POSITION_DIM] - demonstrated[..., : sdk.POSITION_DIM])
    return np.concatenate((positions, angle[..., None]), axis=-1)
