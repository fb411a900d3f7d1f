"""Joints and poses that the authors recorded together, where and what the block `model_io` says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import tables
from xpl.conventions import rotation as rotations
from xpl.conventions.joint_order import JointsPart
from xpl.convert import ConversionError
from xpl.convert.parts import make_part

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from xpl import Embodiment
    from xpl.contract import Entry

_JUDGED = ("joints", "position", "rotation")
_ABSOLUTE = "absolute"
_MOST_ROWS = 256
"""Rows that are looked at, evenly spread; more would tell no more."""
_MOST_PARTS = 64


@dataclass(frozen=True)
class SampleColumns:
    """One part of a vector, with its rows.

    Attributes:
        where: how findings call it.
        kind: joints, position or rotation.
        entry: the part as the block writes it; `arm` says which arm.
        rows: (N, width) numbers as the authors' data have them.
        leads: whether they are commands, which the robot follows.
        unknown: words that the block leaves open; in `entry` a plain value stands for each.
    """

    where: str
    kind: str
    entry: Entry
    rows: np.ndarray
    leads: bool = False
    unknown: frozenset[str] = frozenset()


def collect(model_io: Entry, folders: Sequence[Path], embodiment: Embodiment) -> list[SampleColumns]:
    """Return the joints, positions and rotations of a block's samples; of each as many rows, of the same moments.

    Args:
        model_io: the block, valid by its schema.
        folders: where files may lie: the package.
        embodiment: the robot.

    Raises:
        ConversionError: if samples cannot be read, or do not fit the block or the robot.
    """
    parts = [
        columns
        for index, entry in enumerate(model_io.get("samples", ()))
        for columns in _columns(model_io, entry, f"model_io.samples {index}", folders, embodiment)
    ]
    counts = sorted({len(columns.rows) for columns in parts})
    if len(counts) > 1:
        raise ConversionError(
            f"model_io.samples have {' and '.join(map(str, counts))} rows; row i of each has to be the same moment"
        )
    if not counts:
        return []
    chosen = np.unique(np.linspace(0, counts[0] - 1, min(counts[0], _MOST_ROWS)).round().astype(int))
    return [replace(one, rows=one.rows[chosen]) for one in parts]


def _columns(
    model_io: Entry, entry: Entry, where: str, folders: Sequence[Path], embodiment: Embodiment
) -> Iterator[SampleColumns]:
    vector, leads = _vector(model_io, entry, where)
    if _is_open(vector["parts"]) or len(vector["parts"]) > _MOST_PARTS:
        raise ConversionError(f"{where}: its parts are open, or more than {_MOST_PARTS}")
    rows = _rows(entry, where, folders)
    parts = _closed(vector["parts"], rows.shape[1], embodiment)
    made = [make_part({kind: how}, embodiment) for kind, how, _ in parts]
    widths = sorted(
        {sum(item.width for item in made), *([vector["pad"]] if isinstance(vector.get("pad"), int) else [])}
    )
    if rows.shape[1] not in widths:
        reference = " or ".join(f"(N, {width})" for width in widths)
        raise ConversionError(
            f"{where}: expected rows {reference}, {entry['file']} has the shape {rows.shape}; mend its parts"
        )
    start = 0
    for (kind, how, unknown), one in zip(parts, made, strict=True):
        reference = how.get("reference") or vector.get("reference") or _ABSOLUTE
        is_whole = not isinstance(one, JointsPart) or one.is_whole  # a part of an arm leads nowhere
        if kind in _JUDGED and reference == _ABSOLUTE and is_whole:
            yield SampleColumns(f"{where}, {one.label}", kind, how, rows[:, start : start + one.width], leads, unknown)
        start += one.width


def _closed(
    parts: Sequence[Entry], width: int, embodiment: Embodiment
) -> list[tuple[str, dict[str, Any], frozenset[str]]]:
    """Return kind, words and open words of each part; what is open has a plain value, or none.

    How many numbers a rotation has whose form is open is what the others leave of `width`, where it is the only one.
    """
    result = []
    for item in parts:
        ((kind, how),) = item.items()
        result.append((kind, {key: value for key, value in how.items() if not _is_open(value)}, how))
    rest = [
        make_part({kind: values}, embodiment).width
        for kind, values, _ in result
        if kind != "rotation" or "form" in values
    ]
    forms = {rotations.WIDTHS[form]: form for form in reversed(rotations.WIDTHS) if form != "euler"}
    for kind, values, _ in result:
        if kind == "rotation" and values.get("form") == "euler":
            values.setdefault("euler", "xyz")
        elif kind == "rotation":
            values.setdefault("form", forms.get(width - sum(rest), "quaternion_wxyz"))
    unknown = [{key for key in how if _is_open(how[key])} for _, _, how in result]
    return [
        (kind, values, frozenset(words | {"euler"} if "form" in words else words))
        for (kind, values, _), words in zip(result, unknown, strict=True)
    ]


def _is_open(value: Any) -> bool:
    return isinstance(value, Mapping) and "unknown" in value


def _vector(model_io: Entry, entry: Entry, where: str) -> tuple[Entry, bool]:
    """Return the vector whose rows these are, and whether they are commands."""
    if "parts" in entry:
        return {"parts": entry["parts"]}, False
    if entry["of"] == "action":
        return model_io["action"], True
    vectors = {state["input"]: state for state in model_io.get("state", ())}
    if entry["of"] not in vectors:
        raise ConversionError(
            f"{where}: no vector {entry['of']!r}; say one of {', '.join([*vectors, 'action'])}, or parts"
        )
    return vectors[entry["of"]], False


def _rows(entry: Entry, where: str, folders: Sequence[Path]) -> np.ndarray:
    """Return the rows of an entry, (N, width) float64."""
    path = tables.find(entry["file"], folders)
    if path is None:
        folder_list = ", ".join(map(str, folders))
        raise ConversionError(
            f"{where} names the file {entry['file']}, which is in none of: {folder_list}; copy it there"
        )
    try:
        rows = np.asarray(tables.read(path, entry.get("key", "").split("/")), np.float64)
    except (TypeError, ValueError) as error:
        if isinstance(error, ConversionError):
            raise
        raise ConversionError(f"{where}: {entry['file']} holds no table of numbers there") from None
    if rows.ndim != len(("N", "width")) or not len(rows):
        raise ConversionError(f"{where}: expected rows (N, width), {entry['file']} has the shape {rows.shape}")
    if not np.isfinite(rows).all():
        raise ConversionError(f"{where}: {entry['file']} holds a number that is not finite")
    return rows
