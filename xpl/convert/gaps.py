"""What a model_io block leaves open: `{unknown: why}` in the place of a value.

Conversions cannot be compiled from a block with gaps. What does not depend on them still can be tried: `filled` puts a
plain value in the place of each, and leaves out statistics that are not there.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Union

from xpl import _spec as spec
from xpl.errors import OpenError
from xpl.nested import written

if TYPE_CHECKING:
    from pathlib import Path

    from xpl.contract import Entry
    from xpl.embodiment import Embodiment

Place = tuple[Union[str, int], ...]
"""Keys and positions that lead to a value of the block, from the outside in."""

_OPEN = "unknown"
_TOLD_ONLY = frozenset(("sampling", "recurrent", "samples"))
"""Keys of the block that no conversion reads."""
_WIDTHS = frozenset(("parts", "form", "closed", "open"))
"""Keys of a vector without which nobody knows how many numbers it has."""
_PLAIN: Mapping[str, Any] = {
    "cameras": list(spec.CAMERAS[1][:1]),
    "channels": "rgb",
    "layout": "hwc",
    "dtype": "float32",
    "stack": "views",
    "to": [64, 64],
    "filter": "nearest",
    "form": "quaternion_wxyz",
    "euler": "xyz",
    "reference": "absolute",
    "length": 1,
}
"""What stands for a value that has to be there. Every other one is left out, so that its default counts."""


@dataclass(frozen=True)
class Gap:
    """A value that is open.

    Attributes:
        path: what leads to it, below `model_io`.
        reason: why it is not known.
    """

    path: Place
    reason: str

    @property
    def where(self) -> str:
        """Its place as people read it: `images[0].channels`."""
        return written(self.path)


def gaps(model_io: object) -> list[Gap]:
    """Return every value of a model_io block that is open, in the block's order."""
    return list(_gaps(model_io, ()))


def refuse(model_io: Entry) -> None:
    """Stop where a value that conversions need is open.

    Raises:
        OpenError: with all of them.
    """
    needed = [gap for gap in gaps(model_io) if gap.path[0] not in _TOLD_ONLY]
    if needed:
        told = "; ".join(f"{gap.where} ({gap.reason})" for gap in needed)
        what = "a value" if len(needed) == 1 else f"{len(needed)} values"
        raise OpenError(
            f"model_io leaves {what} open that conversions need: {told}; find them out, write {{assumed: value, why: "
            "reason} where one has to be chosen, or audit what does not depend on them with `--shadow`"
        )


def absent(model_io: Entry, folders: Sequence[Path]) -> list[str]:
    """Return the names of the files of statistics that lie in none of these folders, each once."""
    named = [entry["file"] for entry in map(_normalize, _vectors(model_io)) if "file" in entry]
    return [file for file in dict.fromkeys(named) if not any((folder / file).is_file() for folder in folders)]


def filled(model_io: Entry, embodiment: Embodiment, action_type: str, without: Collection[str] = ()) -> dict[str, Any]:
    """Return a block that can be compiled, of one that has gaps or whose statistics are not there.

    Args:
        model_io: the block.
        embodiment: the robot.
        action_type: joint or ee; what its actions are made of stands for parts that are open.
        without: names of files of statistics that are left out, as those that are `absent`.
    """
    result: dict[str, Any] = _plain(model_io)
    for given, made in zip(_vectors(model_io), _vectors(result)):
        has_width = not any(gap.path[-1] in _WIDTHS for gap in gaps(given))
        if not has_width or _normalize(given).get("file") in without:
            made.pop("normalize", None)
        if not has_width:
            made.pop("pad", None)
        made.setdefault("parts", _parts(embodiment, action_type))
        _agree(given["parts"], made["parts"])
    return result


def _vectors(model_io: Entry) -> Iterator[Any]:
    yield from model_io.get("state", ())
    yield model_io["action"]


def _normalize(vector: Entry) -> Mapping[str, Any]:
    entry: Entry = vector.get("normalize") or {}
    return entry


def _is_open(value: object) -> bool:
    return isinstance(value, Mapping) and set(value) == {_OPEN}


def _gaps(value: Any, path: Place) -> Iterator[Gap]:
    if _is_open(value):
        yield Gap(path, str(value[_OPEN]))
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _gaps(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _gaps(item, (*path, index))


def _plain(value: object) -> Any:
    """Return a part of a block with a plain value for each gap, or without it."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if not isinstance(value, Mapping):
        return value
    result = {}
    for key, item in value.items():
        if key == "crop" and gaps(item):
            result[key] = {"fraction": 1.0}
        elif key == "gripper" and gaps(item):
            result[key] = _gripper(item)
        elif not _is_open(item):
            result[key] = _plain(item)
        elif key in _PLAIN:
            result[key] = _PLAIN[key]
    return result


def _gripper(entry: Entry) -> dict[str, Any]:
    """Return a gripper whose two values differ, as many numbers each as the one that is known has."""
    made = {key: item for key, item in entry.items() if not _is_open(item)}
    ends = [made.get(name) for name in ("closed", "open")]
    known = next((end for end in ends if end is not None), 0.0)
    other = [end + 1.0 for end in known] if isinstance(known, list) else known + 1.0
    for name in ("closed", "open"):
        if name not in made:
            made[name] = known if not {"closed", "open"} & set(made) else other
    return made


def _agree(given: object, made: Sequence[Mapping[str, Any]]) -> None:
    """Leave out point and frame of all of an arm's pose where one of its parts leaves them open."""
    for gap in gaps(given):
        if gap.path and gap.path[-1] in ("point", "frame"):
            arm = made[int(gap.path[0])][str(gap.path[1])]["arm"]
            for entry in (how for part in made for how in part.values() if how.get("arm") == arm):
                entry.pop(str(gap.path[-1]), None)


def _parts(embodiment: Embodiment, action_type: str) -> list[dict[str, Any]]:
    """Return the parts of the standard's own vector."""
    parts: list[dict[str, Any]] = []
    for side, arm in zip(embodiment.data["arms"], embodiment.arms):
        if action_type == spec.ACTION_TYPES[0]:
            parts.append({"joints": {"arm": side}})
        else:
            parts += [{"position": {"arm": side}}, {"rotation": {"arm": side, "form": _PLAIN["form"]}}]
        is_hand = arm.gripper != "parallel_gripper"
        parts.append({"hand": {"arm": side}} if is_hand else {"gripper": {"arm": side, "closed": 0.0, "open": 1.0}})
    return parts
