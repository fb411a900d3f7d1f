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
from xpl.catalogue import Case, Convention, Mistake, fields, pictures, walk
from xpl.catalogue.convention import kinds
from xpl.catalogue.edits import GONE, Block, Change, Site, alike, at, edited, everywhere, parts, without
from xpl.catalogue.part import Numbers, Part, State, arm_of, of
from xpl.conventions.angle_unit import UNITS
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.catalogue.mistake import Obs, Place
    from xpl.contract import Entry
    from xpl.embodiment import Arm, Embodiment

_NAME = "joint_order"
_ZEROS = (90, -90, 180, -180)
"""Where joints of models have their zero, from the standard's, deg."""
_JOINTS, _EFFECTOR = spec.State.ARM_JOINT_STATE, spec.State.EE_JOINT_STATE
_POSES = (spec.State.EE_POSE, spec.State.TCP_POSE, spec.State.DELTA_EE_POSE)

Parts = list[dict[str, Any]]
"""The parts of a vector, in its order."""


class Joints(Part):
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
        angles = of(state, self.key, self.dof)[self._order]
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
        return [int(place) for place in self._order]

    @property
    def is_whole(self) -> bool:
        """Whether it has all joints of the arm."""
        return self.width == self.dof


class Hand(Joints):
    """Joints of a hand."""

    kind = "hand"


def check_joints(parts: Sequence[Part]) -> None:
    """Check that the joints of each arm stand in a vector once, in one part or in several.

    Raises:
        ConversionError: if one is left out, or stands there twice.
    """
    found: dict[str, list[Joints]] = {}
    for item in parts:
        if isinstance(item, Joints):
            found.setdefault(item.key, []).append(item)
    for key, several in found.items():
        places = sorted(place for item in several for place in item.joints)
        if not several[0].is_whole and places != list(range(several[0].dof)):
            told = "; ".join(item.label for item in several)
            raise ConversionError(f"expected each joint of {key} once in all parts together; got {told}")


def _order(names: list[str] | None, arm: Arm, width: int) -> Numbers:
    """Return for each of the model's joints its position in the standard's order."""
    if names is None:
        return np.arange(width)
    known = arm.joint_names
    if known is None:
        raise ConversionError("the standard knows no joint names of this arm; leave names out")
    if not set(names) <= set(known):
        raise ConversionError(f"expected joints of the robot, {', '.join(known)}; got {', '.join(names)}")
    return np.array([known.index(name) for name in names])


def _column(values: object, width: int, default: float, word: str) -> Numbers:
    column = np.full(width, default) if values is None else np.asarray(values, np.float64)
    if column.shape != (width,):
        raise ConversionError(f"{word} has {column.size} entries, expected {width}: one for each joint")
    return column


# -- orders ------------------------------------------------------------------------------------------------------------


def orders(count: int) -> list[tuple[int, str, list[int]]]:
    """Return the orders of joints that were met, as rank, words, and which of the standard's comes where."""
    straight = list(range(count))
    found = [
        (0, "reversed", straight[::-1]),
        (1, "the last one first", [straight[-1], *straight[:-1]]),
        (1, "the first one last", [*straight[1:], straight[0]]),
    ]
    pairs = sorted(itertools.combinations(straight, 2), key=lambda pair: pair[1] - pair[0])
    for one, other in pairs:
        order = list(straight)
        order[one], order[other] = other, one
        found.append((1 if other == one + 1 else 2, f"joints {one + 1} and {other + 1} exchanged", order))
    return found


def signs(count: int) -> Iterator[tuple[int, str, list[float], bool]]:
    """Yield the signs of joints that were met: rank, words, signs, whether some of the places are tried alone."""
    for index in range(count):
        yield 1, f"sign of joint {index + 1}: the other", _others(count, (index,)), True
    yield 2, "signs of all joints: the other", [-1.0] * count, True
    for several in (*itertools.combinations(range(count), 2), *itertools.combinations(range(count), 3)):
        told = ", ".join(str(one + 1) for one in several)
        yield len(several), f"signs of joints {told}: the other", _others(count, several), False


def _others(count: int, places: Sequence[int]) -> list[float]:
    return [-1.0 if place in places else 1.0 for place in range(count)]


# -- in the block ------------------------------------------------------------------------------------------------------


def _in_block(case: Case) -> Iterator[Mistake]:
    if not case.block:
        return
    sites = parts(case.block, "joints")
    arm = case.embodiment.arms[0]
    if arm.joint_names is not None:
        yield from everywhere(sites, 0, "names: the robot's order", _NAME, without("names"))
        for rank, told, order in orders(arm.dof):
            yield from everywhere(sites, rank, f"names: {told}", _NAME, _named(order, list(arm.joint_names)))
    yield from everywhere(sites, 1, "sign: none", _NAME, without("sign"))
    yield from everywhere(sites, 1, "offset: none", _NAME, without("offset"))
    yield from everywhere(sites, 2, "offset: the other way round", _NAME, _negated)
    for rank, told, turned, alone in signs(arm.dof):
        yield from everywhere(sites, rank, told, _NAME, _flipped(turned), alone=alone)
    for key in ("names", "sign", "offset"):
        yield from alike(case.block, ["joints"], key, _NAME)
    yield from _sides(case.block)
    yield from _parts_ordered(case.block)


def _named(order: Sequence[int], known: list[str]) -> Change:
    """Return the change of names, or of those that are known where none are said, to another order."""

    def change(entry: Block) -> Block:
        names = entry.get("names") or known
        changed = [names[index] for index in order]
        return {"names": GONE if changed == known else changed}

    return lambda entry: None if len(entry.get("names") or known) != len(order) else change(entry)


def _negated(entry: Block) -> Block | None:
    return {"offset": [-value for value in entry["offset"]]} if "offset" in entry else None


def _flipped(turned: Sequence[float]) -> Change:
    def change(entry: Block) -> Block | None:
        now = entry.get("sign", [1] * len(turned))
        if len(now) != len(turned):
            return None
        changed = [int(sign * other) for sign, other in zip(now, turned)]
        return {"sign": GONE if set(changed) == {1} else changed}

    return change


def _sides(block: Block) -> Iterator[Mistake]:
    """Yield blocks in which what is of one arm is the other's: parts of all kinds, or of one."""
    for which, told, rank in (
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
                words = f"{told}: left and right exchanged" + (f" ({group})" if group else "")
                convention = "gripper" if told == "grippers" else _NAME
                edits = _exchanged(chosen)
                yield Mistake(rank, words, convention, edits)
                if told == "arms" and not group and (cameras := _wrists(block)):
                    yield Mistake(rank, f"{words}, wrist cameras too", convention, {**edits, **cameras})


def _exchanged(sites: Sequence[Site]) -> dict[Place, Any]:
    other = {"left": "right", "right": "left"}
    return {(*site.place, "arm"): other[site.entry["arm"]] for site in sites}


def _wrists(block: Block) -> dict[Place, Any]:
    places = _wrist_places()
    return {
        ("images", index, "cameras"): [places.get(camera, camera) for camera in entry["cameras"]]
        for index, entry in enumerate(block.get("images") or ())
        if set(entry["cameras"]) & set(places)
    }


def _wrist_places() -> dict[str, str]:
    left, right = spec.CAMERAS[2][-2:]
    return {left: right, right: left}


def _parts_ordered(block: Block) -> Iterator[Mistake]:
    """Yield blocks whose vectors have their parts in another order."""
    state: list[Place] = [("state", index, "parts") for index in range(len(block.get("state") or ()))]
    action: Place = ("action", "parts")
    for places, group in ((([*state, action]), ""), (state, "state"), ([action], "action")):
        told = f" ({group})" if group and state else ""
        for rank, words, change in (
            (1, "the arm's, then the grippers'", _by_kind),
            (1, "arm by arm", _by_arm),
            (1, "grippers first", _grippers_first),
            (2, "reversed", _reversed),
        ):
            edits = {place: change(list(at(block, place))) for place in places}
            if edits and edited(block, edits) != block:
                yield Mistake(rank, f"parts: {words}{told}", _NAME, edits)
    for place in (*state, action):
        listed: Parts = at(block, place)
        for one, other in itertools.combinations(range(len(listed)), 2):
            changed = list(listed)
            changed[one], changed[other] = listed[other], listed[one]
            words = f"parts: {_called(listed[one])} and {_called(listed[other])} exchanged ({place[0]})"
            yield Mistake(2, words, _NAME, {place: changed})
        for one, other in itertools.permutations(range(len(listed)), 2):
            if abs(one - other) > 1:
                changed = [*listed[:one], *listed[one + 1 :]]
                changed.insert(other, listed[one])
                words = f"parts: {_called(listed[one])} at place {other + 1} ({place[0]})"
                yield Mistake(3, words, _NAME, {place: changed})


def _kind(part: Block) -> str:
    return str(next(iter(part)))


def _arm(part: Block) -> str:
    return str(next(iter(part.values())).get("arm", ""))


def _by_kind(listed: Parts) -> Parts:
    return sorted(listed, key=lambda part: _kind(part) in ("gripper", "hand"))


def _grippers_first(listed: Parts) -> Parts:
    return sorted(listed, key=lambda part: _kind(part) not in ("gripper", "hand"))


def _by_arm(listed: Parts) -> Parts:
    seen = list(dict.fromkeys(map(_arm, listed)))
    return sorted(_by_kind(listed), key=lambda part: seen.index(_arm(part)))


def _reversed(listed: Parts) -> Parts:
    return listed[::-1]


def _called(part: Block) -> str:
    arm = _arm(part)
    return _kind(part) + (f" {arm}" if arm not in ("", "single") else "")


# -- around an adapter -------------------------------------------------------------------------------------------------


def _around(case: Case) -> Iterator[Mistake]:
    embodiment = case.embodiment
    for change in _changes(embodiment):
        yield from fields.mistakes(change, case)
    whole = fields.sides(0, "arms", _NAME, (_JOINTS, _EFFECTOR, *_POSES), embodiment)
    for change in whole if case.cameras else ():
        with_wrists = replace(change, words=f"{change.words}, wrist cameras too", ways=("both", "state"))
        yield from fields.mistakes(with_wrists, case, _wrists_shown)


def _wrists_shown(obs: Obs) -> Obs:
    return pictures.placed(_wrist_places())([obs])[0]


def _changes(embodiment: Embodiment) -> Iterator[fields.Change]:
    dof = embodiment.arms[0].dof
    for later, told, prefixes in fields.scopes(embodiment.prefixes):
        keys = [prefix + _JOINTS for prefix in prefixes]
        for rank, name, order in orders(dof):
            back = fields.on(keys, partial(np.take, indices=np.argsort(order), axis=-1))
            there = fields.on(keys, partial(np.take, indices=order, axis=-1))
            yield fields.Change(rank + later, f"joint order{told}: {name}", _NAME, there, back, back)
        for rank, words, turned, alone in signs(dof):
            if alone or not later:
                turn = fields.on(keys, partial(np.multiply, np.asarray(turned)))
                yield fields.Change(rank + later, words.replace(":", f"{told}:"), _NAME, turn, turn, turn)
        for index, degrees in itertools.product(range(dof), _ZEROS):
            there, back = (
                fields.on(keys, partial(_moved, index=index, by=sign * np.deg2rad(degrees))) for sign in (1.0, -1.0)
            )
            words = f"zero of joint {index + 1}{told}: {degrees:+} deg"
            yield fields.Change(2 + later, words, _NAME, there, back, None)
    yield from fields.sides(0, "arms", _NAME, (_JOINTS, _EFFECTOR, *_POSES), embodiment)
    yield from fields.sides(1, "joints", _NAME, (_JOINTS,), embodiment)
    yield from fields.sides(2, "joints and poses", _NAME, (_JOINTS, *_POSES), embodiment)


def _moved(values: Numbers, *, index: int, by: float) -> Numbers:
    result = np.array(values)
    result[..., index] += by
    return result


# -- in encoded inputs -------------------------------------------------------------------------------------------------


def _in_inputs(case: Case) -> Iterator[Mistake]:
    for rank, words, order in _vector_orders(list(case.embodiment.dims(case.action_type).values())):
        for way, told in (("both", ""), ("in", " (state)"), ("out", " (action)")):
            yield Mistake(rank, words + told, _NAME, encoded={"kind": "ordered", "order": order, "way": way})


def _vector_orders(groups: list[int]) -> Iterator[tuple[int, str, list[int]]]:
    """Yield orders of a vector of arms and grippers, each number by where it is taken from."""
    starts = [sum(groups[:place]) for place in range(len(groups))]
    pieces = [list(range(start, start + width)) for start, width in zip(starts, groups)]
    arms, hands = pieces[::2], pieces[1::2]
    flat = [one for piece in pieces for one in piece]
    found = [
        (0, "joint order: reversed", [piece[::-1] if place % 2 == 0 else piece for place, piece in enumerate(pieces)]),
        (1, "parts: grippers first", [piece for arm, hand in zip(arms, hands) for piece in (hand, arm)]),
        (1, "parts: the last number first", [[flat[-1]], flat[:-1]]),
        (1, "parts: the first number last", [flat[1:], [0]]),
        (2, "parts: all numbers in the other order", [flat[::-1]]),
    ]
    if len(arms) > 1:
        joined = [one for piece in (*arms, *hands) for one in piece]
        found += [
            (0, "arms: left and right exchanged", [*pieces[2:], *pieces[:2]]),
            (1, "parts: the arms, then the grippers", [joined]),
            (1, "parts: arm by arm", [[joined.index(place) for place in range(len(joined))]]),
            (1, "parts: the grippers, then the arms", [*hands, *arms]),
            (1, "parts: joints of the arms in turn", [[one for pair in zip(*arms) for one in pair], *hands]),
        ]
    seen = {tuple(flat)}
    for rank, words, order in found:
        numbers = [one for piece in order for one in piece]
        if tuple(numbers) not in seen and len(numbers) == len(flat):
            seen.add(tuple(numbers))
            yield rank, words, numbers


def _ordered(value: Any, how: Mapping[str, Any]) -> Any:
    """Return vectors in another order: `order` says where each number is taken from; others are left.

    Raises:
        UnfitError: if there is no vector of this width.
    """
    order = np.asarray(how["order"])
    return walk.vectors(value, order.size, lambda leaf: leaf[..., order])


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    around=_around,
    in_inputs=_in_inputs,
    kinds={"ordered": _ordered},
    keys={"vectors": ["parts"], "joints": ["names", "offset", "sign"], "hand": ["names", "offset", "sign"]},
    applies=lambda block: bool({"joints", "hand"} & kinds(block)),
    parts={"joints": Joints, "hand": Hand},
)
