"""Other words for positions and rotations."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from xpl_cli.model_io.alternatives.block.edits import GONE, Block, Candidate, Change, Site, everywhere, parts, word

_WIDTHS = (
    ("quaternion_wxyz", "quaternion_xyzw"),
    ("rot6d_columns", "rot6d_rows"),
    ("axis_angle", "euler"),
    ("matrix",),
)
_LIKELY = ("xyz", "XYZ", "zyx", "ZYX")
_EULER = (*_LIKELY, *("".join(order) for letters in ("xyz", "XYZ") for order in itertools.permutations(letters)))


def poses(block: Block) -> Iterator[Candidate]:
    """Yield changes of poses: form and sign of rotations, point, frame, unit, and where a change is applied."""
    yield from _forms(parts(block, "rotation"))
    both = parts(block, "position", "rotation")
    for point in ("tcp", "flange"):
        yield from everywhere(both, 0, f"point: {point}", "point", word("point", point, "flange"))
    for frame in ("base", "world"):
        yield from everywhere(both, 0, f"frame: {frame}", "frame", word("frame", frame, "world"))
    places = parts(block, "position")
    for rank, unit in ((1, "m"), (1, "cm"), (1, "mm")):
        yield from everywhere(places, rank, f"position unit: {unit}", "frame", word("unit", unit, "m"))
    acts = [site for site in both if site.group == "action"]
    for applied in ("fixed", "body", "numbers"):
        told = f"applied: {applied}"
        yield from everywhere(acts, 0, told, "action_reference", word("applied", applied, "fixed"))


def _forms(turns: Sequence[Site]) -> Iterator[Candidate]:
    for forms in _WIDTHS:
        for form in forms:
            if form != "euler":
                yield from everywhere(turns, 0, f"form: {form}", "rotation", _formed(form, forms))
    for order in dict.fromkeys(_EULER):
        rank = 0 if order in _LIKELY else 2
        yield from everywhere(turns, rank, f"form: euler, euler: {order}", "rotation", _euler(order))
    for form in (form for forms in _WIDTHS for form in forms if form != "euler"):
        yield from everywhere(turns, 3, f"form: {form}", "rotation", _formed(form, ()))
    for sign in ("any", "positive_w", "continuous"):
        yield from everywhere(turns, 1, f"sign: {sign}", "rotation", _signed(sign))


def _formed(form: str, among: tuple[str, ...]) -> Change:
    """Return the change to a form, of a rotation in another of these forms, or in any if there are none."""

    def change(entry: Block) -> Block | None:
        if entry["form"] == form or (among and entry["form"] not in among):
            return None
        signed = {} if form.startswith("quaternion") else {"sign": GONE}
        return {"form": form, "euler": GONE, **signed}

    return change


def _euler(order: str) -> Change:
    def change(entry: Block) -> Block | None:
        if entry["form"] not in ("euler", "axis_angle") or entry.get("euler") == order:
            return None
        return {"form": "euler", "euler": order, "sign": GONE}

    return change


def _signed(sign: str) -> Change:
    def change(entry: Block) -> Block | None:
        return word("sign", sign, "any")(entry) if entry["form"].startswith("quaternion") else None

    return change
