"""Changes of what an adapter's own `encode` makes, where observations cannot be changed to the same effect.

Pictures of the standard are bytes of any size: another range, another filter, or letters that the adapter made small
cannot be shown to it. `xpl.worker.encoded.play` carries these changes out.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.model_io.alternatives.block.timing import TEMPLATES
from xpl_cli.model_io.alternatives.forms import MEANS, RANGES

if TYPE_CHECKING:
    from xpl.contract import Entry
    from xpl.embodiment import Embodiment

_FILTERS: tuple[tuple[str, bool], ...] = (
    ("bilinear", True),
    ("bilinear", False),
    ("area", False),
    ("bicubic", True),
    ("bicubic", False),
    ("lanczos", True),
    ("nearest", False),
)
_BOXES: tuple[tuple[int, dict[str, Any]], ...] = (
    (0, {}),
    (1, {"anchor": "bottom_right"}),
    (1, {"anchor": "top_left"}),
    (2, {"fill": 127}),
    (2, {"fill": 128}),
    (2, {"fill": 255}),
)
_CROPS = (0.9, 0.95, 0.875, 0.8, 0.85)
_GRIPPERS: tuple[tuple[str, float, float], ...] = (
    ("a hundred times as much", 100.0, 0.0),
    ("a hundredth", 0.01, 0.0),
    ("255 times as much", 255.0, 0.0),
    ("a 255th", 1 / 255, 0.0),
    ("the other sign", -1.0, 0.0),
    ("closed and open exchanged, 0 to 1", -1.0, 1.0),
    ("closed and open exchanged, 0 to 100", -1.0, 100.0),
    ("-1 to 1, not 0 to 1", 2.0, -1.0),
    ("0 to 1, not -1 to 1", 0.5, 0.5),
    ("1 to -1, not 0 to 1", -2.0, 1.0),
)
_NUMBERS = 40
"""Normalisations by numbers of the adapter's own that are tried at most."""


@dataclass(frozen=True)
class Encoding:
    """One change of encoded inputs.

    Attributes:
        rank: 0 for the likeliest.
        words: what the model means, where the adapter does otherwise.
        convention: of the vocabulary of reference.py.
        how: as `xpl.worker.encoded.play` takes it.
        geometry: of pictures of another size, all but the filter; "" for other changes.
    """

    rank: int
    words: str
    convention: str
    how: Entry = field(hash=False)
    geometry: str = ""


def encodings(
    embodiment: Embodiment,
    action_type: str,
    *,
    pictures: bool = True,
    text: bool = True,
    templates: Sequence[str] = (),
) -> Iterator[Encoding]:
    """Yield changes of encoded inputs, the likeliest first; of those that are as likely, the cheapest.

    Of pictures of another size a process tells how far they are from those before: the geometry of those that are
    nearest is that of the adapter, and where a change leaves it, the filter is the mistake (`convention_of`).

    Args:
        embodiment: the robot.
        action_type: joint or ee.
        pictures: whether the adapter reads any.
        text: whether it reads an instruction.
        templates: of instructions, besides those that are known.
    """
    found = [*_draws(), *_vectors(list(embodiment.dims(action_type).values()))]
    if pictures:
        found = [*_ranges(), *_axes(), *_sizes(), *found]
    if text:
        found += _texts(templates)
    yield from sorted(found, key=lambda one: (one.rank, bool(one.geometry)))  # those last that make pictures again


def convention_of(change: Encoding, nearest: Collection[str]) -> str:
    """Return what a change is about, given the geometries of the pictures that are nearest to the adapter's."""
    return "image_filter" if change.geometry and change.geometry in nearest else change.convention


def _draws() -> Iterator[Encoding]:
    """Yield other draws; without any of them a model draws nothing, and nothing changes."""
    for rank, told, kind in (
        (0, "", "own"),
        (1, ", in double precision", "double"),
        (1, ", in single precision", "single"),
    ):
        words = f"drawn from each environment's generator{told}"
        yield Encoding(rank, words, "sampling", {"kind": "drawn", "as": kind})


def _ranges() -> Iterator[Encoding]:
    forms: list[tuple[int, str, list[list[float]]]] = [
        (rank, f"range: {span}", [[span[0]] * 3, [span[1]] * 3]) for rank, span in RANGES
    ]
    forms.append((2, "range: [0, 1], divided by 255 once more", [[0.0] * 3, [1 / 255] * 3]))
    bytes_forms: list[tuple[int, str, list[list[float]]]] = []
    for name, (mean, std) in MEANS.items():
        if name == "0.5":  # which is the range from -1 to 1
            continue
        for told, order in (("", slice(None)), (", of the other order of channels", slice(None, None, -1))):
            ends = [(one, other) for one, other in zip(mean[order], std[order], strict=True)]
            black, white = [-one / other for one, other in ends], [(1 - one) / other for one, other in ends]
            forms.append((1 + bool(told), f"mean and std: {name}{told}", [black, white]))
            white = [(255 - one) / other for one, other in ends]
            bytes_forms.append((2, f"mean and std: {name}{told}, of 0 to 255", [black, white]))
    pairs = [*itertools.permutations(forms, 2), *itertools.product(forms, bytes_forms)]
    for (rank, words, to), (other_rank, other, of) in pairs:
        how = {"kind": "scaled", "of": of, "to": to}
        told = other.removeprefix("range: ") if words.startswith("range: ") else other
        yield Encoding(max(rank, other_rank), f"{words}, not {told}", "image_range", how)


def _axes() -> Iterator[Encoding]:
    yield Encoding(0, "channels: red and blue exchanged", "image_channels", {"kind": "colours"})
    for layout in ("hwc", "chw"):
        yield Encoding(1, f"layout: {layout}", "image_range", {"kind": "layout", "to": layout})
    yield Encoding(2, "height and width exchanged", "image_orientation", {"kind": "layout", "to": "turned"})
    yield Encoding(2, "stack: two pictures the other way (width or height)", "camera", {"kind": "beside"})


def _sizes() -> Iterator[Encoding]:
    for place, (kind, antialias) in enumerate(_FILTERS):
        words = f"filter: {kind}" + (", antialias" if antialias and kind != "lanczos" else "")
        how = {"filter": kind, "antialias": antialias}
        steps: list[tuple[int, str, list[dict[str, Any]]]] = [(0, "resize", [{"resize": how}])]
        steps += [(rank, f"letterbox{_told(box)}", [{"letterbox": {**how, **box}}]) for rank, box in _BOXES]
        steps += [(2, f"crop to {part}, resize", [{"crop": {"fraction": part}}, {"resize": how}]) for part in _CROPS]
        steps += [(1, "the middle square, resize", [{"square": {}}, {"resize": how}])]
        exchanged = {"kind": "resized", "steps": [{"resize": how}], "exchanged": True}
        told = f"resize, height and width exchanged, {words}"
        yield Encoding(1 + (place > 3), told, "image_size", exchanged, "exchanged")
        for rank, geometry, made in steps:
            later = 1 if rank and place > 3 else 0
            told = f"{geometry}, {words}"
            yield Encoding(rank + later, told, "image_size", {"kind": "resized", "steps": made}, geometry)


def _told(box: Entry) -> str:
    return "".join(f", {key}: {value}" for key, value in box.items())


def _texts(templates: Sequence[str]) -> Iterator[Encoding]:
    for rank, case, strip in (
        (0, "keep", ""),
        (0, "lower", ""),
        (0, "keep", " "),
        (1, "lower", " "),
        (1, "keep", ". "),
        (1, "lower", ". "),
    ):
        how = {"kind": "text", "case": case, "strip": strip}
        words = f"instruction: case: {case}, strip: {strip!r}"
        yield Encoding(rank, words, sdk.Obs.INSTRUCTION, how)
        for template in dict.fromkeys((*templates, *TEMPLATES)):
            told = f"{words}, template: {template!r}"
            yield Encoding(rank + 1, told, sdk.Obs.INSTRUCTION, {**how, "template": template})


def _vectors(groups: Sequence[int]) -> Iterator[Encoding]:
    for number in range(_NUMBERS):
        how = {"kind": "normalized", "number": number}
        yield Encoding(1, "normalize: other numbers", "normalization", how)
        segmented = {"kind": "segmented", "number": number}
        yield Encoding(1, "normalize: other numbers of a part", "normalization", segmented)
    hands = [sum(groups[: place + 1]) - 1 for place in range(1, len(groups), 2) if groups[place] == 1]
    for told, scale, offset in _GRIPPERS if hands else ():
        how = {"kind": "linear", "width": sum(groups), "places": hands, "scale": scale, "offset": offset}
        yield Encoding(1, f"gripper as the model reads it: {told}", "gripper", how)
    for rank, words, order in _orders(list(groups)):
        for way, told in (("both", ""), ("in", " (state)"), ("out", " (action)")):
            yield Encoding(rank, words + told, "joint_order", {"kind": "ordered", "order": order, "way": way})
    for rank, words, turn in (
        (0, "rotation: rows for columns, or columns for rows", "transposed"),
        (1, "rotation: two columns, number by number", "interleaved"),
        (1, "rotation: two rows or columns, one after the other", "apart"),
        (0, "quaternion: the last number first", "last_first"),
        (0, "quaternion: the first number last", "first_last"),
        (1, "quaternion: w >= 0, w first", "positive_first"),
        (1, "quaternion: w >= 0, w last", "positive_last"),
        (1, "quaternion: the other sign", "negative"),
    ):
        yield Encoding(rank, words, "rotation", {"kind": "rotation", "turn": turn})


def _orders(groups: list[int]) -> Iterator[tuple[int, str, list[int]]]:
    """Yield orders of a vector of arms and grippers, each number by where it is taken from."""
    starts = [sum(groups[:place]) for place in range(len(groups))]
    parts = [list(range(start, start + width)) for start, width in zip(starts, groups, strict=True)]
    arms, hands = parts[::2], parts[1::2]
    orders = [
        (0, "joint order: reversed", [part[::-1] if place % 2 == 0 else part for place, part in enumerate(parts)]),
        (
            1,
            "parts: the grippers' first",
            [part for arm, hand in zip(arms, hands, strict=True) for part in (hand, arm)],
        ),
        (1, "parts: the last number first", [[parts[-1][-1]], [one for part in parts for one in part][:-1]]),
        (1, "parts: the first number last", [[one for part in parts for one in part][1:], [0]]),
        (2, "parts: all numbers in the other order", [part[::-1] for part in parts[::-1]]),
    ]
    if len(arms) > 1:
        orders += [
            (0, "arms: left and right exchanged", [*parts[2:], *parts[:2]]),
            (1, "parts: the arms, then the grippers", [*arms, *hands]),
            (1, "parts: arm by arm", _undone([*arms, *hands], groups)),
            (1, "parts: the grippers, then the arms", [*hands, *arms]),
        ]
    seen = {tuple(range(sum(groups)))}
    for rank, words, order in orders:
        flat = [one for part in order for one in part]
        if tuple(flat) not in seen:
            seen.add(tuple(flat))
            yield rank, words, flat


def _undone(order: list[list[int]], groups: list[int]) -> list[list[int]]:
    flat = [one for part in order for one in part]
    back = [flat.index(place) for place in range(len(flat))]
    starts = [sum(groups[:place]) for place in range(len(groups))]
    return [back[start : start + width] for start, width in zip(starts, groups, strict=True)]
