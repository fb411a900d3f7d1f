"""What a model answers as the standard's action steps, and back.

Source: spec/v1/model_io.schema.json, `action`. An answer loses its padding, is denormalised, and cut into parts;
each part is counted from what its reference says; parts of one arm make joint angles or a pose.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from xpl import rotation
from xpl.conventions.action_reference import counted, uncounted
from xpl.convert.assembly import assembled
from xpl.convert.parts import Position, Rotation
from xpl.convert.vectors import Vector
from xpl.decoding import decode_rows
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from pathlib import Path

    from xpl.catalogue.part import Part, State
    from xpl.contract import Action, Entry
    from xpl.embodiment import Embodiment

Memory = MutableMapping[str, np.ndarray]
"""What is remembered of one environment between two answers: the last command, by part."""


class ActionOutput:
    """The action vector of a model.

    Args:
        entry: `action` of the model_io block.
        embodiment: the robot.
        action_type: joint or ee.
        folders: where files of statistics may lie.

    Attributes:
        vector: its parts, normalisation and padding.
        first, steps: which of the model's steps are handed on; steps is None for all from `first` on.

    Raises:
        ConversionError: if it does not make actions of this kind for this robot.
    """

    def __init__(self, entry: Entry, embodiment: Embodiment, action_type: str, folders: Sequence[Path] = ()) -> None:
        self._embodiment, self._action_type = embodiment, action_type
        self.vector = Vector(entry, embodiment, folders, "model_io.action")
        self.first: int = entry.get("first", 0)
        self.steps: int | None = entry.get("steps")
        self._reference: str = entry["reference"]
        self._check()

    def decode(self, raw: np.ndarray, state: State, memory: Memory | None = None) -> list[dict[str, np.ndarray]]:
        """Return the action steps of an answer.

        Args:
            raw: (H, D) numbers of the model.
            state: the observation's, at the call.
            memory: of this environment; needed where an action is counted from the command before.

        Raises:
            ActionError: if the answer makes no legal action.
            ConversionError: if its shape is not the block's.
        """
        kept = {} if memory is None else memory
        needed = self.first + (1 if self.steps is None else self.steps)
        if np.ndim(raw) != 2 or len(raw) < needed:
            raise ConversionError(
                f"model_io.action: expected at least {needed} steps (first {self.first}, and those handed on), "
                f"the model gave the shape {np.shape(raw)}; mend first, steps or temporal.chunk"
            )
        columns = self._counted(raw, state, kept)
        end = None if self.steps is None else self.first + self.steps
        chosen = {label: values[self.first : end] for label, values in columns.items()}
        for label, values in chosen.items():
            kept[label] = values[-1]
        return decode_rows(self._flat(chosen, state), self._embodiment, self._action_type)

    def fields(self, raw: np.ndarray, state: State, memory: Memory | None = None) -> dict[str, np.ndarray]:
        """Return the standard's fields, (H, width) float64 by key, of an answer as it is: nothing is judged or mended.

        Args:
            raw: (H, D) numbers.
            state: the observation's, at the call; where every part is absolute, only its keys count.
            memory: as for `decode`.

        Raises:
            ConversionError: if the answer has not the block's width.
        """
        kept = {} if memory is None else memory
        columns = self._counted(raw, state, kept)
        for label, values in columns.items():
            kept[label] = values[-1]
        return assembled(self._parts, columns, state)

    def encode(self, steps: Sequence[Action], state: State, memory: Memory | None = None) -> np.ndarray:
        """Return the answer (H, D), float64, that means these action steps; the inverse of `decode`.

        Steps before `first` repeat the first one.
        """
        kept = {} if memory is None else memory
        given = [steps[0]] * self.first + list(steps)
        absolute = {item.label: np.stack([item.read(_as_state(step, state)) for step in given]) for item in self._parts}
        pieces = [self._relative(item, absolute, state, kept) for item in self._parts]
        for item in self._parts:
            kept[item.label] = absolute[item.label][-1]
        return self.vector.normalized(np.concatenate(pieces, axis=-1))

    @property
    def is_relative(self) -> bool:
        """Whether any part is counted from something."""
        return any(self._told(item) != "absolute" for item in self._parts)

    @property
    def _parts(self) -> list[Part]:
        return self.vector.parts

    def _counted(self, raw: np.ndarray, state: State, memory: Memory) -> dict[str, np.ndarray]:
        """Return the absolute numbers of each part, (H, width) by label, still the model's."""
        rows = self.vector.denormalized(np.asarray(raw, np.float64))
        columns: dict[str, np.ndarray] = {}
        for item, values in self.vector.cut(rows):
            columns[item.label] = self._absolute(item, values, state, memory, columns)
        return columns

    def _told(self, item: Part) -> str:
        return item.reference or self._reference

    def _absolute(
        self, item: Part, values: np.ndarray, state: State, memory: Memory, done: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Return the absolute numbers of one part, (H, width), still the model's."""
        told = self._told(item)
        if told == "absolute":
            return values
        start = item.read(state)
        turns = self._turns(item, state, memory, done, len(values))

        def add(base: np.ndarray, change: np.ndarray, index: int) -> np.ndarray:
            if isinstance(item, Position) and item.applied == "body":
                change = item.turned(change, turns[index])  # the change as the world sees it
            return item.add(base, change)

        return np.stack(counted(told, list(values), start, memory.get(item.label, start), add))

    def _relative(self, item: Part, absolute: Mapping[str, np.ndarray], state: State, memory: Memory) -> np.ndarray:
        """Return what the model says of the absolute numbers of one part, (H, width)."""
        told, wanted = self._told(item), absolute[item.label]
        if told == "absolute":
            return wanted
        start = item.read(state)
        turns = self._turns(item, state, memory, absolute, len(wanted))

        def subtract(base: np.ndarray, values: np.ndarray, index: int) -> np.ndarray:
            change = item.subtract(values, base)
            if isinstance(item, Position) and item.applied == "body":
                change = rotation.rotate(rotation.conjugate(turns[index]), change)
            return change

        return np.stack(uncounted(told, list(wanted), start, memory.get(item.label, start), subtract))

    def _turns(
        self, item: Part, state: State, memory: Memory, done: Mapping[str, np.ndarray], height: int
    ) -> Sequence[np.ndarray]:
        """Return for each step the rotation (4,) in which a change of position in the moving frame is given."""
        if not isinstance(item, Position) or item.applied != "body":
            return []
        turn = self._rotation_of(item)
        told, now = self._told(item), turn.read(state)
        start = memory.get(turn.label, now) if told == "delta_command" else now
        following = [] if told == "delta_state" else list(done[turn.label][:-1])
        return [turn.write(values) for values in [start, *following, *[start] * height][:height]]

    def _rotation_of(self, item: Position) -> Rotation:
        found = next((one for one in self._parts if isinstance(one, Rotation) and one.key == item.key), None)
        if found is None:
            raise ConversionError(
                f"model_io.action, {item.label}: applied: body needs the arm's rotation, and no part gives it; add it"
            )
        if found.frame.told != item.frame.told:
            raise ConversionError(
                f"model_io.action, {item.label}: its point and frame differ from its rotation's; say the same for both"
            )
        return found

    def _flat(self, columns: Mapping[str, np.ndarray], state: State) -> np.ndarray:
        """Return rows (H, D) of flat absolute actions of the standard."""
        made = assembled(self._parts, columns, state)
        return np.concatenate([made[key] for key in self._embodiment.dims(self._action_type)], axis=-1)

    def _check(self) -> None:
        for item in self._parts:
            if isinstance(item, Position) and item.applied == "body":
                self._rotation_of(item)
        labels = [item.label for item in self._parts]
        twice = sorted({label for label in labels if labels.count(label) > 1})
        if twice:
            raise ConversionError(f"model_io.action has a part twice: {', '.join(twice)}; one command has one place")
        keys = {item.key for item in self._parts}
        extra = [item.label for item in self._parts if item.key not in {"", *self._embodiment.dims(self._action_type)}]
        if extra:
            raise ConversionError(
                f"model_io.action has {', '.join(extra)}, which {self._action_type} actions do not; "
                "leave it out, say fill, or declare the other action type"
            )
        lacking = [key for key in self._embodiment.dims(self._action_type) if key not in keys]
        if lacking:
            raise ConversionError(
                f"model_io.action makes no {self._action_type} actions of {self._embodiment.name}: "
                f"no part gives {', '.join(lacking)}; add it, or declare another action type"
            )


def _as_state(step: Action, state: State) -> State:
    return {**state, **step}
