"""Unit, direction and zero of grippers. Source: spec/v1/model_io.schema.json#/$defs/gripper."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.catalogue import AdapterCase, Convention, Mistake, fields, walk
from xpl.catalogue.convention import kinds
from xpl.catalogue.edits import Block, EntryChange, mistakes_at_sites, parts, remove_key, set_key
from xpl.catalogue.part import Numbers, Part, State, arm_of, state_field
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.contract import Entry
    from xpl.embodiment import Embodiment

_NAME = "gripper"
_PARALLEL = "parallel_gripper"


class GripperPart(Part):
    """A parallel gripper: its opening, 0 closed and 1 open, between the model's two values."""

    kind = "gripper"

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        super().__init__(f"gripper {entry['arm']}")
        arm = arm_of(embodiment, entry["arm"])
        if arm.gripper != "parallel_gripper":
            raise ConversionError(f"{embodiment.name} has a hand there; say hand, not gripper")
        self.key = arm.prefix + spec.State.EE_JOINT_STATE
        self._closed, self._open = np.atleast_1d(np.float64(entry["closed"])), np.atleast_1d(np.float64(entry["open"]))
        if self._closed.shape != self._open.shape:
            raise ConversionError(f"{self._closed.size} values closed and {self._open.size} open; give as many of each")
        if (self._closed == self._open).all():
            raise ConversionError("closed and open are the same; say the model's two values")
        self.width = self._closed.size
        self._threshold = entry.get("threshold")
        self.reference = entry.get("reference", "absolute")

    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) of a state."""
        opening = state_field(state, self.key, 1)
        result: Numbers = self._closed + opening * (self._open - self._closed)
        return result

    def write(self, values: Numbers) -> Numbers:
        """Return absolute numbers (..., width) as the standard's."""
        span = self._open - self._closed
        if self._threshold is not None:
            first = int(np.flatnonzero(span)[0])
            beyond: Numbers = (values[..., first] - self._threshold) * np.sign(span[first]) > 0
            return beyond.astype(np.float64)[..., None]
        # Several fingers: the opening that fits them best.
        opening = ((values - self._closed) * span).sum(-1) / (span * span).sum()
        return np.asarray(opening)[..., None]


# -- mistakes ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ModelGripperRange:
    """What a model says for closed and open.

    Attributes:
        rank: 0 for the likeliest.
        closed, open: its two numbers.
        called: what they are, "" where the numbers say it.
    """

    rank: int
    closed: float
    open: float
    called: str = ""

    @property
    def label(self) -> str:
        """The two in words."""
        return self.called or f"closed {self.closed:g}, open {self.open:g}"

    def scale_and_offset_from(self, other: ModelGripperRange) -> tuple[float, float]:
        """Return scale and offset that lead from the numbers of another range to this one's."""
        scale = (self.open - self.closed) / (other.open - other.closed)
        return scale, self.closed - scale * other.closed

    def opening_scale_and_offset(self, other: ModelGripperRange) -> tuple[float, float]:
        """Return scale and offset of an opening that another range has to see, so that its numbers are this one's."""
        span = other.open - other.closed
        return (self.open - self.closed) / span, (self.closed - other.closed) / span


PLAIN, INVERTED = ModelGripperRange(0, 0.0, 1.0), ModelGripperRange(0, 1.0, 0.0)
FIXED = (
    PLAIN,
    INVERTED,
    ModelGripperRange(1, -1.0, 1.0),
    ModelGripperRange(1, 1.0, -1.0),
    ModelGripperRange(2, 0.0, 100.0),
    ModelGripperRange(2, 100.0, 0.0),
    ModelGripperRange(2, 0.0, 255.0),
    ModelGripperRange(2, 255.0, 0.0),
)
"""The standard's and OpenVLA's, robosuite's, percent, and Robotiq's counts."""


def ranges(stroke: float | None) -> list[ModelGripperRange]:
    """Return the ranges that models were met with, for a gripper that opens by `stroke`, m, or by nobody knows what."""
    candidates = list(FIXED)
    for extra_rank, metres, of_what in ((0, stroke, "between the fingers"), (1, (stroke or 0) / 2, "of a finger")):
        if metres:
            candidates += [
                ModelGripperRange(extra_rank, 0.0, metres, f"metres {of_what}"),
                ModelGripperRange(1 + extra_rank, 0.0, 1000 * metres, f"millimetres {of_what}"),
                ModelGripperRange(2, 0.0, 100 * metres, f"centimetres {of_what}"),
                ModelGripperRange(2 + extra_rank, metres, 0.0, f"metres {of_what}, closed and open exchanged"),
            ]
    return candidates


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if not case.block:
        return
    sites = parts(case.block, "gripper")
    yield from mistakes_at_sites(sites, 0, "gripper: closed and open exchanged", _NAME, _swap_ends)
    for one in ranges(case.embodiment.arms[0].stroke):
        label = f"gripper: closed {one.closed:g}, open {one.open:g}"
        yield from mistakes_at_sites(sites, one.rank, label, _NAME, _set_range(one))
    for factor, label in ((2.0, "open is twice as much"), (0.5, "open is half as much")):
        yield from mistakes_at_sites(sites, 1, f"gripper: {label}", _NAME, _scale_open(factor))
    yield from mistakes_at_sites(sites, 1, "gripper: the fingers exchanged", _NAME, _swap_fingers)
    for label, turn in (("the second finger's sign", (1.0, -1.0)), ("the first finger's sign", (-1.0, 1.0))):
        yield from mistakes_at_sites(sites, 1, f"gripper: {label}: the other", _NAME, _flip_finger(turn))
    acts = [site for site in sites if site.group == "action"]
    yield from mistakes_at_sites(acts, 1, "gripper: no threshold", _NAME, remove_key("threshold"))
    yield from mistakes_at_sites(acts, 2, "gripper: threshold in the middle", _NAME, _set_middle_threshold)
    for value in (0.0, 0.5):
        yield from mistakes_at_sites(acts, 2, f"gripper: threshold {value:g}", _NAME, set_key("threshold", value))


def _swap_ends(entry: Block) -> Block:
    return {"closed": entry["open"], "open": entry["closed"]}


def _has_fingers(entry: Block) -> bool:
    return isinstance(entry["closed"], list) or isinstance(entry["open"], list)


def _set_range(one: ModelGripperRange) -> EntryChange:
    def change(entry: Block) -> Block | None:
        if _has_fingers(entry):
            return None  # another number of fingers is another width
        same = (entry["closed"], entry["open"]) == (one.closed, one.open)
        return None if same else {"closed": one.closed, "open": one.open}

    return change


def _scale_open(factor: float) -> EntryChange:
    def change(entry: Block) -> Block | None:
        if _has_fingers(entry):
            if not (isinstance(entry["closed"], list) and isinstance(entry["open"], list)):
                return None
            pairs = zip(entry["closed"], entry["open"])
            return {"open": [closed + factor * (opened - closed) for closed, opened in pairs]}
        return {"open": entry["closed"] + factor * (entry["open"] - entry["closed"])}

    return change


def _swap_fingers(entry: Block) -> Block | None:
    if not isinstance(entry["open"], list) or not isinstance(entry["closed"], list):
        return None
    return {"closed": entry["closed"][::-1], "open": entry["open"][::-1]}


def _flip_finger(turn: Sequence[float]) -> EntryChange:
    """Return the change of a finger that moves the other way."""

    def change(entry: Block) -> Block | None:
        ends = {key: entry[key] for key in ("closed", "open")}
        if any(not isinstance(end, list) or len(end) != len(turn) for end in ends.values()):
            return None
        return {key: [sign * value for sign, value in zip(turn, end)] for key, end in ends.items()}

    return change


def _set_middle_threshold(entry: Block) -> Block | None:
    return None if _has_fingers(entry) else set_key("threshold", (entry["closed"] + entry["open"]) / 2)(entry)


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for change in _changes(case.embodiment):
        yield from fields.field_mistakes(change, case)


def _changes(embodiment: Embodiment) -> Iterator[fields.FieldChange]:
    """Yield the ranges of parallel grippers.

    A command that is quite closed or quite open may have been clipped: what it would be otherwise is not known.
    """
    yield from fields.swap_sides(0, "grippers", _NAME, (spec.State.EE_JOINT_STATE,), embodiment)
    if embodiment.arms[0].gripper != _PARALLEL:
        return
    for extra_rank, label, prefixes in fields.arm_scopes(embodiment.prefixes):
        keys = [prefix + spec.State.EE_JOINT_STATE for prefix in prefixes]
        for rank, name, scale, offset in _openings(embodiment.arms[0].stroke):
            change = fields.linear(rank + extra_rank, f"gripper{label}: {name}", _NAME, keys, scale, offset)
            yield replace(
                change, to_standard=fields.map_fields(keys, partial(_undo_opening, scale=scale, offset=offset))
            )


def _openings(stroke: float | None) -> Iterator[tuple[int, str, float, float]]:
    """Yield rank, words, scale and offset of the opening that an adapter has to see, each once."""
    yield 0, "closed and open exchanged", -1.0, 1.0
    yield 0, "open is half as much", 0.5, 0.0
    yield 0, "open is twice as much", 2.0, 0.0
    seen = {(1.0, 0.0), (-1.0, 1.0), (0.5, 0.0), (2.0, 0.0)}
    candidates = ranges(stroke)
    for model, adapter in [*((one, PLAIN) for one in candidates), *itertools.product((PLAIN, INVERTED), candidates)]:
        scale, offset = model.opening_scale_and_offset(adapter)
        if not _is_repeated(seen, scale, offset):
            label = model.label if adapter is PLAIN else f"{model.label}, not {adapter.label}"
            yield max(model.rank, adapter.rank), label, scale, offset


def _is_repeated(seen: set[tuple[float, float]], scale: float, offset: float) -> bool:
    key = (float(f"{scale:.9g}"), float(f"{offset:.9g}") + 0.0)
    is_repeated = key in seen
    seen.add(key)
    return is_repeated


def _undo_opening(values: Numbers, *, scale: float, offset: float) -> Numbers:
    back = np.clip((values - offset) / scale, spec.GRIPPER_CLOSED, spec.GRIPPER_OPEN)
    if (scale, offset) == (-1.0, 1.0):  # what is clipped there is clipped here
        return back
    inner = (values > spec.GRIPPER_CLOSED) & (values < spec.GRIPPER_OPEN)
    return np.where(inner, back, np.nan)


def _input_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    groups = list(case.embodiment.dims(case.action_type).values())
    hands = [sum(groups[: index + 1]) - 1 for index in range(1, len(groups), 2) if groups[index] == 1]
    seen = {(1.0, 0.0)}
    for model, adapter in itertools.permutations(FIXED, 2) if hands else ():
        scale, offset = model.scale_and_offset_from(adapter)
        if not _is_repeated(seen, scale, offset):
            how = {"kind": "linear", "width": sum(groups), "places": hands, "scale": scale, "offset": offset}
            words = f"gripper as the model reads it: {model.label}, not {adapter.label}"
            yield Mistake(max(1, model.rank, adapter.rank), words, _NAME, input_change=how)


def _linear(value: Any, how: Mapping[str, Any]) -> Any:
    """Return vectors with some numbers scaled and moved: `width` of the vectors, `places`, `scale` and `offset`.

    Raises:
        NoEffectError: if there is no vector of this width.
    """

    def change(leaf: Any) -> Any:
        if not walk.is_vector(leaf):
            return None
        result = np.array(leaf, np.float64)
        result[..., how["places"]] = result[..., how["places"]] * how["scale"] + how["offset"]
        return result

    return walk.map_vectors(value, how["width"], change)


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    input_mistakes=_input_mistakes,
    input_changes={"linear": _linear},
    keys={"gripper": ["closed", "open", "threshold"]},
    applies=lambda block: "gripper" in kinds(block),
    parts={"gripper": GripperPart},
)
