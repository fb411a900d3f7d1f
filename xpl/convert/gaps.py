"""Unknown values of a model_io block: `{unknown: why}` in place of a value.

Conversions cannot be compiled from a block with unknown values. To test what does not depend on them, `fill_gaps` puts
a placeholder in place of each, and removes statistics whose file is missing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Union

from xpl import _spec as spec
from xpl.errors import UnknownValueError
from xpl.nested import format_path

if TYPE_CHECKING:
    from pathlib import Path

    from xpl.contract import Entry
    from xpl.embodiment import Embodiment

BlockPath = tuple[Union[str, int], ...]
"""Keys and indices that lead to a value of the block, from the outside in."""

_OPEN = "unknown"
_NOT_CONVERTED = frozenset(("sampling", "recurrent", "samples"))
"""Keys of the block that no conversion reads."""
_WIDTHS = frozenset(("parts", "form", "closed", "open"))
"""Keys that the width of a vector depends on."""
_PLACEHOLDERS: Mapping[str, Any] = {
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
"""Placeholders of required values. Any other unknown value is removed, so that its default applies."""


@dataclass(frozen=True)
class UnknownValue:
    """An unknown value.

    Attributes:
        path: its path below `model_io`.
        reason: why it is unknown.
    """

    path: BlockPath
    reason: str

    @property
    def where(self) -> str:
        """Its path as text: `images[0].channels`."""
        return format_path(self.path)


def gaps(model_io: object) -> list[UnknownValue]:
    """Return the unknown values of a model_io block, in the block's order."""
    return list(_gaps(model_io, ()))


def refuse_gaps(model_io: Entry) -> None:
    """Raise if a value that conversions need is unknown.

    Raises:
        UnknownValueError: lists all of them.
    """
    needed = [gap for gap in gaps(model_io) if gap.path[0] not in _NOT_CONVERTED]
    if needed:
        listed = "; ".join(f"{gap.where} ({gap.reason})" for gap in needed)
        what = "a value" if len(needed) == 1 else f"{len(needed)} values"
        raise UnknownValueError(
            f"model_io leaves {what} open that conversions need: {listed}; find them out, write {{assumed: value, why: "
            "reason} where one has to be chosen, or audit what does not depend on them with `--shadow`"
        )


def missing_files(model_io: Entry, folders: Sequence[Path]) -> list[str]:
    """Return the names of the statistics files that are in none of these folders, each once."""
    named = [entry["file"] for entry in map(_normalize, _vectors(model_io)) if "file" in entry]
    return [file for file in dict.fromkeys(named) if not any((folder / file).is_file() for folder in folders)]


def fill_gaps(
    model_io: Entry, embodiment: Embodiment, action_type: str, without: Collection[str] = ()
) -> dict[str, Any]:
    """Return a copy of a block that can be compiled, without unknown values and missing statistics.

    Args:
        model_io: the block.
        embodiment: the robot.
        action_type: joint or ee; its parts replace unknown ones.
        without: names of statistics files to remove (`missing_files`).

    Returns:
        The block, with placeholders.
    """
    result: dict[str, Any] = _fill(model_io)
    for vector, made in zip(_vectors(model_io), _vectors(result)):
        has_width = not any(gap.path[-1] in _WIDTHS for gap in gaps(vector))
        if not has_width or _normalize(vector).get("file") in without:
            made.pop("normalize", None)
        if not has_width:
            made.pop("pad", None)
        made.setdefault("parts", _parts(embodiment, action_type))
        _drop_open_frames(vector["parts"], made["parts"])
    return result


def _vectors(model_io: Entry) -> Iterator[Any]:
    yield from model_io.get("state", ())
    yield model_io["action"]


def _normalize(vector: Entry) -> Mapping[str, Any]:
    entry: Entry = vector.get("normalize") or {}
    return entry


def _is_open(value: object) -> bool:
    return isinstance(value, Mapping) and set(value) == {_OPEN}


def _gaps(value: Any, path: BlockPath) -> Iterator[UnknownValue]:
    if _is_open(value):
        yield UnknownValue(path, str(value[_OPEN]))
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _gaps(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _gaps(item, (*path, index))


def _fill(value: object) -> Any:
    """Return a part of a block with unknown values replaced by placeholders, or removed."""
    if isinstance(value, list):
        return [_fill(item) for item in value]
    if not isinstance(value, Mapping):
        return value
    result = {}
    for key, item in value.items():
        if key == "crop" and gaps(item):
            result[key] = {"fraction": 1.0}
        elif key == "gripper" and gaps(item):
            result[key] = _gripper(item)
        elif not _is_open(item):
            result[key] = _fill(item)
        elif key in _PLACEHOLDERS:
            result[key] = _PLACEHOLDERS[key]
    return result


def _gripper(entry: Entry) -> dict[str, Any]:
    """Return a gripper entry with two different values of the width of the known one."""
    made = {key: item for key, item in entry.items() if not _is_open(item)}
    ends = [made.get(name) for name in ("closed", "open")]
    end_value = next((end for end in ends if end is not None), 0.0)
    other = [end + 1.0 for end in end_value] if isinstance(end_value, list) else end_value + 1.0
    for name in ("closed", "open"):
        if name not in made:
            made[name] = end_value if not {"closed", "open"} & set(made) else other
    return made


def _drop_open_frames(parts: object, made: Sequence[Mapping[str, Any]]) -> None:
    """Remove point and frame from all parts of an arm's pose if they are unknown in one of them."""
    for gap in gaps(parts):
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
            parts += [{"position": {"arm": side}}, {"rotation": {"arm": side, "form": _PLACEHOLDERS["form"]}}]
        is_hand = arm.gripper != "parallel_gripper"
        parts.append({"hand": {"arm": side}} if is_hand else {"gripper": {"arm": side, "closed": 0.0, "open": 1.0}})
    return parts
