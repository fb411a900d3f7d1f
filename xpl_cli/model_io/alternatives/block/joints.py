"""Other words for joints, hands and grippers."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.model_io.alternatives.block.edits import (
    GONE,
    Block,
    Candidate,
    Change,
    Place,
    Site,
    edited,
    everywhere,
    parts,
    word,
)

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment

_GRIPPERS: tuple[tuple[int, float, float], ...] = (
    (0, 0.0, 1.0),
    (0, 1.0, 0.0),
    (1, -1.0, 1.0),
    (1, 1.0, -1.0),
    (2, 0.0, 100.0),
    (2, 0.0, 255.0),
    (2, 255.0, 0.0),
    (3, 0.0, 0.5),
    (3, 0.0, 2.0),
)
"""Rank, closed and open of grippers that were met."""


Parts = list[dict[str, Any]]
"""The parts of a vector, in its order."""


def joints(block: Block, embodiment: Embodiment) -> Iterator[Candidate]:
    """Yield changes of joint angles: unit, order, signs, offsets."""
    sites = parts(block, "joints", "hand")
    for unit in ("deg", "rad"):
        yield from everywhere(sites, 0, f"unit: {unit}", "angle_unit", word("unit", unit, "rad"))
    sites = parts(block, "joints")
    known = embodiment.arms[0].joint_names
    if known is not None:
        yield from everywhere(sites, 0, "names: the robot's order", "joint_order", _without("names"))
        orders = _orders(embodiment.arms[0].dof)
        for rank, told, order in orders:
            yield from everywhere(sites, rank, f"names: {told}", "joint_order", _named(order, list(known)))
    yield from everywhere(sites, 1, "sign: none", "joint_order", _without("sign"))
    yield from everywhere(sites, 1, "offset: none", "joint_order", _without("offset"))
    yield from everywhere(sites, 2, "offset: the other way round", "joint_order", _negated("offset"))
    dof = embodiment.arms[0].dof
    for index in range(dof):
        told = f"sign of joint {index + 1}: the other"
        yield from everywhere(sites, 1, told, "joint_order", _flipped([index], dof))
    yield from everywhere(sites, 2, "sign: the other of all", "joint_order", _flipped(range(dof), dof))
    for count in (2, 3):
        for several in itertools.combinations(range(dof), count):
            told = f"signs of joints {', '.join(str(one + 1) for one in several)}: the other"
            yield from everywhere(sites, count, told, "joint_order", _flipped(several, dof), alone=False)
    yield from _alike(block)


def _orders(count: int) -> list[tuple[int, str, list[int]]]:
    straight = list(range(count))
    found = [
        (0, "reversed", straight[::-1]),
        (2, "the last one first", [straight[-1], *straight[:-1]]),
        (2, "the first one last", [*straight[1:], straight[0]]),
    ]
    pairs = sorted(itertools.combinations(straight, 2), key=lambda pair: pair[1] - pair[0])
    for one, other in pairs:
        order = list(straight)
        order[one], order[other] = other, one
        found.append((1 if other == one + 1 else 3, f"joints {one + 1} and {other + 1} exchanged", order))
    return found


def _named(order: Sequence[int], known: list[str]) -> Change:
    """Return the change of names, or of those that are known where none are said, to another order."""

    def of(entry: Block) -> Block:
        names = entry.get("names") or known
        changed = [names[index] for index in order]
        return {"names": GONE if changed == known else changed}

    return of


def _without(key: str) -> Change:
    return lambda entry: {key: GONE} if key in entry else None


def _negated(key: str) -> Change:
    return lambda entry: {key: [-value for value in entry[key]]} if key in entry else None


def _alike(block: Block) -> Iterator[Candidate]:
    """Yield parts of the state that say what the action's of the same arm say, and the other way round."""
    for kind, words in (
        ("joints", {"names": "joint_order", "sign": "joint_order", "offset": "joint_order", "unit": "angle_unit"}),
        ("rotation", {"form": "rotation", "point": "point", "frame": "frame"}),
        ("position", {"point": "point", "frame": "frame", "unit": "frame"}),
    ):
        sites = parts(block, kind)
        for key, convention in words.items():
            for group, other in (("state", "action"), ("action", "state")):
                said = {site.name: site.entry.get(key, GONE) for site in sites if site.group == other}
                edits = {
                    (*site.place, key): said[site.name]
                    for site in sites
                    if site.group == group
                    and said.get(site.name, site.entry.get(key, GONE)) != site.entry.get(key, GONE)
                }
                if edits:
                    yield Candidate(1, f"{kind}: {key} of the {group} as of the {other}", convention, edits)


def _flipped(places: Sequence[int], count: int) -> Change:
    def change(entry: Block) -> Block:
        signs = entry.get("sign", [1] * count)
        changed = [-value if position in places else value for position, value in enumerate(signs)]
        return {"sign": GONE if set(changed) == {1} else changed}

    return change


def grippers(block: Block, embodiment: Embodiment) -> Iterator[Candidate]:
    """Yield changes of grippers: direction, scale, unit, threshold, reference, and whose they are."""
    sites = parts(block, "gripper")
    stroke = embodiment.arms[0].stroke
    yield from everywhere(sites, 0, "gripper: closed and open exchanged", "gripper", _exchanged)
    ends = list(_GRIPPERS)
    if stroke:
        ends += [(0, 0.0, stroke), (0, 0.0, stroke / 2), (1, 0.0, 1000 * stroke), (2, 0.0, 500 * stroke)]
        ends += [(2, 0.0, 100 * stroke), (2, stroke, 0.0), (2, stroke / 2, 0.0)]
    for rank, closed, opened in ends:
        told = f"gripper: closed {closed:g}, open {opened:g}"
        yield from everywhere(sites, rank, told, "gripper", _ended(closed, opened))
    for factor, told in ((2.0, "open is twice as much"), (0.5, "open is half as much")):
        yield from everywhere(sites, 1, f"gripper: {told}", "gripper", _scaled(factor))
    yield from everywhere(sites, 1, "gripper: the fingers exchanged", "gripper", _fingers)
    acts = [site for site in sites if site.group == "action"]
    yield from everywhere(acts, 1, "gripper: no threshold", "gripper", _without("threshold"))
    yield from everywhere(acts, 2, "gripper: threshold in the middle", "gripper", _middle)
    for value in (0.0, 0.5):
        change = word("threshold", value)
        yield from everywhere(acts, 2, f"gripper: threshold {value:g}", "gripper", change)
    for reference in ("delta_state", "absolute", "delta_command", "cumulative"):
        rank = 1 if reference in ("delta_state", "absolute") else 3
        told = f"gripper: reference: {reference}"
        yield from everywhere(acts, rank, told, "action_reference", word("reference", reference, "absolute"))


def _exchanged(entry: Block) -> Block:
    return {"closed": entry["open"], "open": entry["closed"]}


def _ended(closed: float, opened: float) -> Change:
    def change(entry: Block) -> Block | None:
        if isinstance(entry["closed"], list) or isinstance(entry["open"], list):
            return None  # another number of fingers is another width
        same = (entry["closed"], entry["open"]) == (closed, opened)
        return None if same else {"closed": closed, "open": opened}

    return change


def _scaled(factor: float) -> Change:
    def change(entry: Block) -> Block | None:
        if isinstance(entry["closed"], list) or isinstance(entry["open"], list):
            if not (isinstance(entry["closed"], list) and isinstance(entry["open"], list)):
                return None
            pairs = zip(entry["closed"], entry["open"], strict=True)
            return {"open": [closed + factor * (opened - closed) for closed, opened in pairs]}
        return {"open": entry["closed"] + factor * (entry["open"] - entry["closed"])}

    return change


def _fingers(entry: Block) -> Block | None:
    if not isinstance(entry["open"], list) or not isinstance(entry["closed"], list):
        return None
    return {"closed": entry["closed"][::-1], "open": entry["open"][::-1]}


def _middle(entry: Block) -> Block | None:
    closed, opened = entry["closed"], entry["open"]
    if isinstance(closed, list) or isinstance(opened, list):
        return None
    return word("threshold", (closed + opened) / 2)(entry)


def arms(block: Block) -> Iterator[Candidate]:
    """Yield blocks in which what is of one arm is the other's: parts of all kinds, or of one."""
    for kinds, told, rank in (
        (("joints", "hand", "gripper", "position", "rotation"), "arms", 0),
        (("gripper", "hand"), "grippers", 0),
        (("joints",), "joints", 1),
        (("position", "rotation"), "poses", 1),
        (("position",), "positions", 2),
        (("rotation",), "rotations", 2),
    ):
        sites = [site for site in parts(block, *kinds) if site.name]
        for group in ("", "state", "action"):
            chosen = [site for site in sites if group in ("", site.group)]
            if len({site.name for site in chosen}) == 2:
                words = f"{told}: left and right exchanged" + (f" ({group})" if group else "")
                convention = "gripper" if told == "grippers" else "joint_order"
                edits: dict[Place, Any] = _sides(chosen)
                yield Candidate(rank, words, convention, edits)
                if told == "arms" and not group and (cameras := _wrists(block)):
                    yield Candidate(rank, f"{words}, wrist cameras too", convention, {**edits, **cameras})


def _sides(sites: Sequence[Site]) -> dict[Place, Any]:
    other = {"left": "right", "right": "left"}
    return {(*site.place, "arm"): other[site.entry["arm"]] for site in sites}


def _wrists(block: Block) -> dict[Place, Any]:
    left, right = sdk.CAMERAS[2][-2:]
    other = {left: right, right: left}
    return {
        ("images", index, "cameras"): [other.get(camera, camera) for camera in entry["cameras"]]
        for index, entry in enumerate(block.get("images") or ())
        if set(entry["cameras"]) & set(other)
    }


def order(block: Block) -> Iterator[Candidate]:
    """Yield blocks whose vectors have their parts in another order."""
    state = [("state", index, "parts") for index in range(len(block.get("state") or ()))]
    action = ("action", "parts")
    for places, group in ((([*state, action]), ""), (state, "state"), ([action], "action")):
        told = f" ({group})" if group and state else ""
        yield from _reordered(block, places, 1, f"parts: the arm's, then the grippers'{told}", _by_kind)
        yield from _reordered(block, places, 1, f"parts: arm by arm{told}", _by_arm)
        yield from _reordered(block, places, 1, f"parts: grippers first{told}", _grippers_first)
        yield from _reordered(block, places, 2, f"parts: reversed{told}", lambda listed: listed[::-1])
    for place in (*state, action):
        listed = _at(block, place)
        for one, other in itertools.combinations(range(len(listed)), 2):
            changed = list(listed)
            changed[one], changed[other] = listed[other], listed[one]
            words = f"parts: {_called(listed[one])} and {_called(listed[other])} exchanged ({place[0]})"
            yield Candidate(2, words, "joint_order", {place: changed})
        for one, other in itertools.permutations(range(len(listed)), 2):
            if abs(one - other) > 1:
                changed = [*listed[:one], *listed[one + 1 :]]
                changed.insert(other, listed[one])
                words = f"parts: {_called(listed[one])} at place {other + 1} ({place[0]})"
                yield Candidate(3, words, "joint_order", {place: changed})


def _at(block: Block, place: Place) -> Parts:
    spot: Any = block
    for key in place:
        spot = spot[key]
    found: Parts = spot
    return found


def _reordered(
    block: Block, places: Sequence[Place], rank: int, words: str, change: Callable[[Parts], Parts]
) -> Iterator[Candidate]:
    edits = {place: change(list(_at(block, place))) for place in places}
    if edits and edited(block, edits) != block:
        yield Candidate(rank, words, "joint_order", edits)


def _kind(part: Block) -> str:
    return next(iter(part))


def _arm(part: Block) -> str:
    return str(next(iter(part.values())).get("arm", ""))


def _by_kind(listed: Parts) -> Parts:
    return sorted(listed, key=lambda part: _kind(part) in ("gripper", "hand"))


def _grippers_first(listed: Parts) -> Parts:
    return sorted(listed, key=lambda part: _kind(part) not in ("gripper", "hand"))


def _by_arm(listed: Parts) -> Parts:
    seen = list(dict.fromkeys(map(_arm, listed)))
    return sorted(_by_kind(listed), key=lambda part: seen.index(_arm(part)))


def _called(part: Block) -> str:
    arm = _arm(part)
    return _kind(part) + (f" {arm}" if arm not in ("", "single") else "")
