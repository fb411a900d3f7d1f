"""Changes of what an adapter's own `encode` makes, where observations cannot be changed to the same effect.

Pictures of the standard are bytes of any size: another range, another filter, or letters that the adapter made small
cannot be shown to it. `xpl.worker.encoded.play` carries these changes out.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from xpl_cli.native.alternatives.block.timing import TEMPLATES
from xpl_cli.native.alternatives.forms import MEANS, RANGES

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
_NUMBERS = 40
"""Normalisations by numbers of the adapter's own that are tried at most."""


@dataclass(frozen=True)
class Encoding:
    """One change of encoded inputs.

    Attributes:
        rank: 0 for the likeliest.
        words: what the model means, where the adapter does otherwise.
        convention: of the vocabulary of native.py.
        how: as `xpl.worker.encoded.play` takes it.
        geometry: of pictures of another size, all but the filter; "" for other changes.
    """

    rank: int
    words: str
    convention: str
    how: Mapping[str, Any] = field(hash=False)
    geometry: str = ""


def encodings(*, pictures: bool = True, text: bool = True) -> Iterator[Encoding]:
    """Yield changes of encoded inputs, the likeliest first.

    Of pictures of another size a process tells how far they are from those before: the geometry of those that are
    nearest is that of the adapter, and where a change leaves it, the filter is the mistake (`convention_of`).

    Args:
        pictures: whether the adapter reads any.
        text: whether it reads an instruction.
    """
    found = [*_vectors()]
    if pictures:
        found = [*_ranges(), *_axes(), *_sizes(), *found]
    if text:
        found += _texts()
    yield from sorted(found, key=lambda one: one.rank)


def convention_of(change: Encoding, nearest: str) -> str:
    """Return what a change is about, given the geometry of the pictures that are nearest to the adapter's."""
    return "image_filter" if change.geometry and change.geometry == nearest else change.convention


def _ranges() -> Iterator[Encoding]:
    forms: list[tuple[int, str, list[list[float]]]] = [
        (rank, f"range: {span}", [[span[0]] * 3, [span[1]] * 3]) for rank, span in RANGES
    ]
    for name, (mean, std) in MEANS.items():
        if name == "0.5":  # which is the range from -1 to 1
            continue
        for told, order in (("", slice(None)), (", of the other order of channels", slice(None, None, -1))):
            ends = [(one, other) for one, other in zip(mean[order], std[order], strict=True)]
            black, white = [-one / other for one, other in ends], [(1 - one) / other for one, other in ends]
            forms.append((1 + bool(told), f"mean and std: {name}{told}", [black, white]))
    for (rank, words, to), (other_rank, other, of) in itertools.permutations(forms, 2):
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
        for rank, geometry, made in steps:
            later = 1 if rank and place > 3 else 0
            told = f"{geometry}, {words}"
            yield Encoding(rank + later, told, "image_size", {"kind": "resized", "steps": made}, geometry)


def _told(box: Mapping[str, Any]) -> str:
    return "".join(f", {key}: {value}" for key, value in box.items())


def _texts() -> Iterator[Encoding]:
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
        yield Encoding(rank, words, "instruction", how)
        for template in TEMPLATES:
            told = f"{words}, template: {template!r}"
            yield Encoding(rank + 1, told, "instruction", {**how, "template": template})


def _vectors() -> Iterator[Encoding]:
    for number in range(_NUMBERS):
        how = {"kind": "normalized", "number": number}
        yield Encoding(1, "normalize: other numbers", "normalization", how)
    for rank, order, words in (
        (1, "last_of_halves", "parts: the arms, then the grippers"),
        (1, "apart", "parts: arm by arm"),
        (1, "last_first", "parts: the last number first"),
        (1, "first_last", "parts: the first number last"),
        (2, "halves", "parts: the halves exchanged"),
        (2, "reversed", "parts: all numbers in the other order"),
    ):
        yield Encoding(rank, words, "joint_order", {"kind": "ordered", "order": order})
