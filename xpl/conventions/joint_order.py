"""Order, sign and offset of joints, and which vector or arm comes first.

Source: spec/v1/model_io.schema.json#/$defs/joints.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.catalogue import AdapterCase, Convention, Mistake, fields, image_changes, walk
from xpl.catalogue.convention import kinds
from xpl.catalogue.edits import (
    REMOVE,
    Block,
    EntryChange,
    Site,
    apply_edits,
    copy_between_state_and_action,
    mistakes_at_sites,
    parts,
    remove_key,
    value_at,
)
from xpl.catalogue.part import Numbers, Part, State, arm_of, state_field
from xpl.conventions.angle_unit import UNITS
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.catalogue.mistake import BlockPath, Obs
    from xpl.contract import Entry
    from xpl.embodiment import Arm, Embodiment

_NAME = "joint_order"
_ZEROS = (90, -90, 180, -180)
"""Where joints of models have their zero, from the standard's, deg."""
_JOINTS, _EFFECTOR = spec.State.ARM_JOINT_STATE, spec.State.EE_JOINT_STATE
_POSES = (spec.State.EE_POSE, spec.State.TCP_POSE, spec.State.DELTA_EE_POSE)

Parts = list[dict[str, Any]]
"""The parts of a vector, in its order."""


class JointsPart(Part):
    """Joint angles of an arm, or of a hand; of some joints, where others stand elsewhere in the vector.

    Attributes:
        dof: joints of the whole arm, or hand.
    """

    kind = "joints"

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        is_hand = self.kind == "hand"
        super().__init__(f"{self.kind} {entry['arm']}")
        arm = arm_of(embodiment, entry["arm"])
        self.key = arm.prefix + (spec.State.EE_JOINT_STATE if is_hand else spec.State.ARM_JOINT_STATE)
        self.dof = arm.ee_dim if is_hand else arm.dof
        if is_hand and arm.gripper == "parallel_gripper":
            raise ConversionError(f"{embodiment.name} has a parallel gripper there; say gripper, not hand")
        self._order = _order(entry.get("names"), arm, self.dof)
        self.width = len(self._order)
        if self.width < self.dof:
            self.label += f" {', '.join(entry['names'])}"
        self._sign = _column(entry.get("sign"), self.width, 1.0, "sign")
        self._offset = _column(entry.get("offset"), self.width, 0.0, "offset")
        self._scale = UNITS[entry.get("unit", "rad")]
        self.reference = entry.get("reference")

    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) of a state."""
        angles = state_field(state, self.key, self.dof)[self._order]
        result: Numbers = self._sign * angles * self._scale + self._offset
        return result

    def write(self, values: Numbers) -> Numbers:
        """Return the arm's angles (..., DOF), rad, of absolute numbers (..., width); NaN for joints of other parts."""
        angles: Numbers = self._sign * (values - self._offset) / self._scale
        result = np.full((*angles.shape[:-1], self.dof), np.nan)
        result[..., self._order] = angles
        return result

    @property
    def joints(self) -> list[int]:
        """Places of its joints in the standard's order."""
        return [int(index) for index in self._order]

    @property
    def is_whole(self) -> bool:
        """Whether it has all joints of the arm."""
        return self.width == self.dof


class HandPart(JointsPart):
    """Joints of a hand."""

    kind = "hand"


def check_joints(parts: Sequence[Part]) -> None:
    """Check that the joints of each arm stand in a vector once, in one part or in several.

    Raises:
        ConversionError: if one is left out, or stands there twice.
    """
    parts_by_key: dict[str, list[JointsPart]] = {}
    for item in parts:
        if isinstance(item, JointsPart):
            parts_by_key.setdefault(item.key, []).append(item)
    for key, several in parts_by_key.items():
        indices = sorted(index for item in several for index in item.joints)
        if not several[0].is_whole and indices != list(range(several[0].dof)):
            labels = "; ".join(item.label for item in several)
            raise ConversionError(f"expected each joint of {key} once in all parts together; got {labels}")


def _order(names: list[str] | None, arm: Arm, width: int) -> Numbers:
    """Return for each of the model's joints its position in the standard's order."""
    if names is None:
        return np.arange(width)
    joint_names = arm.joint_names
    if joint_names is None:
        raise ConversionError("the standard knows no joint names of this arm; leave names out")
    if not set(names) <= set(joint_names):
        raise ConversionError(f"expected joints of the robot, {', '.join(joint_names)}; got {', '.join(names)}")
    return np.array([joint_names.index(name) for name in names])


def _column(values: object, width: int, default: float, word: str) -> Numbers:
    column = np.full(width, default) if values is None else np.asarray(values, np.float64)
    if column.shape != (width,):
        raise ConversionError(f"{word} has {column.size} entries, expected {width}: one for each joint")
    return column


# -- orders ------------------------------------------------------------------------------------------------------------


def orders(count: int) -> list[tuple[int, str, list[int]]]:
    """Return the orders of joints that were met, as rank, words, and which of the standard's comes where."""
    straight = list(range(count))
    orders = [
        (0, "reversed", straight[::-1]),
        (1, "the last one first", [straight[-1], *straight[:-1]]),
        (1, "the first one last", [*straight[1:], straight[0]]),
    ]
    pairs = sorted(itertools.combinations(straight, 2), key=lambda pair: pair[1] - pair[0])
    for one, other in pairs:
        order = list(straight)
        order[one], order[other] = other, one
        orders.append((1 if other == one + 1 else 2, f"joints {one + 1} and {other + 1} exchanged", order))
    return orders


def signs(count: int) -> Iterator[tuple[int, str, list[float], bool]]:
    """Yield the signs of joints that were met: rank, words, signs, whether some of the places are tried alone."""
    for index in range(count):
        yield 1, f"sign of joint {index + 1}: the other", _flip_signs(count, (index,)), True
    yield 2, "signs of all joints: the other", [-1.0] * count, True
    for several in (*itertools.combinations(range(count), 2), *itertools.combinations(range(count), 3)):
        label = ", ".join(str(one + 1) for one in several)
        yield len(several), f"signs of joints {label}: the other", _flip_signs(count, several), False


def _flip_signs(count: int, indices: Sequence[int]) -> list[float]:
    return [-1.0 if index in indices else 1.0 for index in range(count)]


# -- in the block ------------------------------------------------------------------------------------------------------


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if not case.block:
        return
    sites = parts(case.block, "joints")
    arm = case.embodiment.arms[0]
    if arm.joint_names is not None:
        yield from mistakes_at_sites(sites, 0, "names: the robot's order", _NAME, remove_key("names"))
        for rank, label, order in orders(arm.dof):
            yield from mistakes_at_sites(
                sites, rank, f"names: {label}", _NAME, _set_names(order, list(arm.joint_names))
            )
    yield from mistakes_at_sites(sites, 1, "sign: none", _NAME, remove_key("sign"))
    yield from mistakes_at_sites(sites, 1, "offset: none", _NAME, remove_key("offset"))
    yield from mistakes_at_sites(sites, 2, "offset: the other way round", _NAME, _negate_offset)
    for rank, label, turned, alone in signs(arm.dof):
        yield from mistakes_at_sites(sites, rank, label, _NAME, _set_signs(turned), partial=alone)
    for key in ("names", "sign", "offset"):
        yield from copy_between_state_and_action(case.block, ["joints"], key, _NAME)
    yield from _swap_sides(case.block)
    yield from _reorder_parts(case.block)


def _set_names(order: Sequence[int], robot_names: list[str]) -> EntryChange:
    """Return the change of names, or of those that are known where none are said, to another order."""

    def change(entry: Block) -> Block:
        names = entry.get("names") or robot_names
        changed = [names[index] for index in order]
        return {"names": REMOVE if changed == robot_names else changed}

    return lambda entry: None if len(entry.get("names") or robot_names) != len(order) else change(entry)


def _negate_offset(entry: Block) -> Block | None:
    return {"offset": [-value for value in entry["offset"]]} if "offset" in entry else None


def _set_signs(turned: Sequence[float]) -> EntryChange:
    def change(entry: Block) -> Block | None:
        now = entry.get("sign", [1] * len(turned))
        if len(now) != len(turned):
            return None
        changed = [int(sign * other) for sign, other in zip(now, turned)]
        return {"sign": REMOVE if set(changed) == {1} else changed}

    return change


def _swap_sides(block: Block) -> Iterator[Mistake]:
    """Yield blocks in which what is of one arm is the other's: parts of all kinds, or of one."""
    for which, label, rank in (
        (("joints", "hand", "gripper", "position", "rotation"), "arms", 0),
        (("gripper", "hand"), "grippers", 0),
        (("joints",), "joints", 1),
        (("position", "rotation"), "poses", 1),
        (("position",), "positions", 2),
        (("rotation",), "rotations", 2),
    ):
        sites = [site for site in parts(block, *which) if site.name]
        for group in ("", "state", "action"):
            chosen = [site for site in sites if group in ("", site.group)]
            if len({site.name for site in chosen}) == 2:
                words = f"{label}: left and right exchanged" + (f" ({group})" if group else "")
                convention = "gripper" if label == "grippers" else _NAME
                edits = _swap_arms(chosen)
                yield Mistake(rank, words, convention, edits)
                if label == "arms" and not group and (cameras := _wrists(block)):
                    yield Mistake(rank, f"{words}, wrist cameras too", convention, {**edits, **cameras})


def _swap_arms(sites: Sequence[Site]) -> dict[BlockPath, Any]:
    other = {"left": "right", "right": "left"}
    return {(*site.path, "arm"): other[site.entry["arm"]] for site in sites}


def _wrists(block: Block) -> dict[BlockPath, Any]:
    places = _wrist_places()
    return {
        ("images", index, "cameras"): [places.get(camera, camera) for camera in entry["cameras"]]
        for index, entry in enumerate(block.get("images") or ())
        if set(entry["cameras"]) & set(places)
    }


def _wrist_places() -> dict[str, str]:
    left, right = spec.CAMERAS[2][-2:]
    return {left: right, right: left}


def _reorder_parts(block: Block) -> Iterator[Mistake]:
    """Yield blocks whose vectors have their parts in another order."""
    state: list[BlockPath] = [("state", index, "parts") for index in range(len(block.get("state") or ()))]
    action: BlockPath = ("action", "parts")
    for paths, group in ((([*state, action]), ""), (state, "state"), ([action], "action")):
        label = f" ({group})" if group and state else ""
        for rank, words, change in (
            (1, "the arm's, then the grippers'", _by_kind),
            (1, "arm by arm", _by_arm),
            (1, "grippers first", _grippers_first),
            (2, "reversed", _reversed),
        ):
            edits = {path: change(list(value_at(block, path))) for path in paths}
            if edits and apply_edits(block, edits) != block:
                yield Mistake(rank, f"parts: {words}{label}", _NAME, edits)
    for path in (*state, action):
        listed: Parts = value_at(block, path)
        for one, other in itertools.combinations(range(len(listed)), 2):
            changed = list(listed)
            changed[one], changed[other] = listed[other], listed[one]
            words = f"parts: {_part_name(listed[one])} and {_part_name(listed[other])} exchanged ({path[0]})"
            yield Mistake(2, words, _NAME, {path: changed})
        for one, other in itertools.permutations(range(len(listed)), 2):
            if abs(one - other) > 1:
                changed = [*listed[:one], *listed[one + 1 :]]
                changed.insert(other, listed[one])
                words = f"parts: {_part_name(listed[one])} at place {other + 1} ({path[0]})"
                yield Mistake(3, words, _NAME, {path: changed})


def _kind(part: Block) -> str:
    return str(next(iter(part)))


def _arm(part: Block) -> str:
    return str(next(iter(part.values())).get("arm", ""))


def _by_kind(listed: Parts) -> Parts:
    return sorted(listed, key=lambda part: _kind(part) in ("gripper", "hand"))


def _grippers_first(listed: Parts) -> Parts:
    return sorted(listed, key=lambda part: _kind(part) not in ("gripper", "hand"))


def _by_arm(listed: Parts) -> Parts:
    arms = list(dict.fromkeys(map(_arm, listed)))
    return sorted(_by_kind(listed), key=lambda part: arms.index(_arm(part)))


def _reversed(listed: Parts) -> Parts:
    return listed[::-1]


def _part_name(part: Block) -> str:
    arm = _arm(part)
    return _kind(part) + (f" {arm}" if arm not in ("", "single") else "")


# -- around an adapter -------------------------------------------------------------------------------------------------


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    embodiment = case.embodiment
    for change in _changes(embodiment):
        yield from fields.field_mistakes(change, case)
    whole = fields.swap_sides(0, "arms", _NAME, (_JOINTS, _EFFECTOR, *_POSES), embodiment)
    for change in whole if case.cameras else ():
        with_wrists = replace(change, description=f"{change.description}, wrist cameras too", targets=("both", "state"))
        yield from fields.field_mistakes(with_wrists, case, _swap_wrist_images)


def _swap_wrist_images(obs: Obs) -> Obs:
    return image_changes.swap_cameras(_wrist_places())([obs])[0]


def _changes(embodiment: Embodiment) -> Iterator[fields.FieldChange]:
    dof = embodiment.arms[0].dof
    for extra_rank, label, prefixes in fields.arm_scopes(embodiment.prefixes):
        keys = [prefix + _JOINTS for prefix in prefixes]
        for rank, name, order in orders(dof):
            back = fields.map_fields(keys, partial(np.take, indices=np.argsort(order), axis=-1))
            there = fields.map_fields(keys, partial(np.take, indices=order, axis=-1))
            yield fields.FieldChange(rank + extra_rank, f"joint order{label}: {name}", _NAME, there, back, back)
        for rank, words, turned, alone in signs(dof):
            if alone or not extra_rank:
                turn = fields.map_fields(keys, partial(np.multiply, np.asarray(turned)))
                yield fields.FieldChange(rank + extra_rank, words.replace(":", f"{label}:"), _NAME, turn, turn, turn)
        for index, degrees in itertools.product(range(dof), _ZEROS):
            there, back = (
                fields.map_fields(keys, partial(_add_offset, index=index, by=sign * np.deg2rad(degrees)))
                for sign in (1.0, -1.0)
            )
            words = f"zero of joint {index + 1}{label}: {degrees:+} deg"
            yield fields.FieldChange(2 + extra_rank, words, _NAME, there, back, None)
    yield from fields.swap_sides(0, "arms", _NAME, (_JOINTS, _EFFECTOR, *_POSES), embodiment)
    yield from fields.swap_sides(1, "joints", _NAME, (_JOINTS,), embodiment)
    yield from fields.swap_sides(2, "joints and poses", _NAME, (_JOINTS, *_POSES), embodiment)


def _add_offset(values: Numbers, *, index: int, by: float) -> Numbers:
    result = np.array(values)
    result[..., index] += by
    return result


# -- in encoded inputs -------------------------------------------------------------------------------------------------


def _input_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for rank, words, order in _vector_orders(list(case.embodiment.dims(case.action_type).values())):
        for way, label in (("both", ""), ("in", " (state)"), ("out", " (action)")):
            yield Mistake(rank, words + label, _NAME, input_change={"kind": "ordered", "order": order, "way": way})


def _vector_orders(groups: list[int]) -> Iterator[tuple[int, str, list[int]]]:
    """Yield orders of a vector of arms and grippers, each number by where it is taken from."""
    starts = [sum(groups[:index]) for index in range(len(groups))]
    pieces = [list(range(start, start + width)) for start, width in zip(starts, groups)]
    arms, hands = pieces[::2], pieces[1::2]
    flat = [one for piece in pieces for one in piece]
    orders = [
        (0, "joint order: reversed", [piece[::-1] if index % 2 == 0 else piece for index, piece in enumerate(pieces)]),
        (1, "parts: grippers first", [piece for arm, hand in zip(arms, hands) for piece in (hand, arm)]),
        (1, "parts: the last number first", [[flat[-1]], flat[:-1]]),
        (1, "parts: the first number last", [flat[1:], [0]]),
        (2, "parts: all numbers in the other order", [flat[::-1]]),
    ]
    if len(arms) > 1:
        joined = [one for piece in (*arms, *hands) for one in piece]
        orders += [
            (0, "arms: left and right exchanged", [*pieces[2:], *pieces[:2]]),
            (1, "parts: the arms, then the grippers", [joined]),
            (1, "parts: arm by arm", [[joined.index(number) for number in range(len(joined))]]),
            (1, "parts: the grippers, then the arms", [*hands, *arms]),
            (1, "parts: joints of the arms in turn", [[one for pair in zip(*arms) for one in pair], *hands]),
        ]
    seen = {tuple(flat)}
    for rank, words, order in orders:
        numbers = [one for piece in order for one in piece]
        if tuple(numbers) not in seen and len(numbers) == len(flat):
            seen.add(tuple(numbers))
            yield rank, words, numbers


def _reorder_vector(value: Any, how: Mapping[str, Any]) -> Any:
    """Return vectors in another order: `order` says where each number is taken from; others are left.

    Raises:
        NoEffectError: if there is no vector of this width.
    """
    order = np.asarray(how["order"])
    return walk.map_vectors(value, order.size, lambda leaf: leaf[..., order])


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    input_mistakes=_input_mistakes,
    input_changes={"ordered": _reorder_vector},
    keys={"vectors": ["parts"], "joints": ["names", "offset", "sign"], "hand": ["names", "offset", "sign"]},
    applies=lambda block: bool({"joints", "hand"} & kinds(block)),
    parts={"joints": JointsPart, "hand": HandPart},
)
