"""Normalisation: a vector's numbers as the model gets them, and back.

Source: spec/v1/model_io.schema.json#/$defs/normalize. The numbers come from the manifest or from a file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.convert import tables
from xpl.convert.errors import ConversionError

if TYPE_CHECKING:
    from xpl.contract import Entry

_NAMES = {"mean_std": ("mean", "std"), "min_max": ("min", "max"), "quantiles": ("low", "high")}
_CONSTANT = {
    "keep": ((1.0, 0.0), (0.0, 1.0)),
    "zero": ((np.inf, 0.0), (0.0, 1.0)),
    "shift": ((1.0, 1.0), (1.0, 1.0)),
}
"""Dimensions that never moved, there and back: the scale, and whether min, low or mean is the shift."""


class Normalization:
    """One rule with its numbers.

    Args:
        entry: `normalize` of a vector; None leaves numbers as they are.
        width: numbers that it is applied to.
        folders: where its file may lie: the package, a checkpoint.
        padded: numbers of the padded vector; statistics may have as many, and the first are used.

    Raises:
        ConversionError: if the numbers cannot be had, or are not as many as the vector has.
    """

    def __init__(
        self, entry: Entry | None, width: int, folders: Sequence[Path] = (), padded: int | None = None
    ) -> None:
        self._clip = (entry or {}).get("clip")
        self._to, self._back = _Line(width), _Line(width)
        if entry is None:
            return
        rule, epsilon = entry["rule"], entry.get("epsilon", 0.0)
        one, two = (_numbers(entry, name, folders, width, padded) for name in _NAMES[rule])
        only = np.asarray(entry.get("only", [True] * width), bool)
        if only.shape != (width,):
            raise ConversionError(f"normalize.only has {only.size} entries, expected {width}: one for each number")
        span = two if rule == "mean_std" else two - one
        constant = only & (span == 0)
        how = entry.get("constant", "refuse")
        span = np.where(constant, epsilon, span) if how == "epsilon" else span + epsilon
        if how in ("refuse", "epsilon") and (only & (span == 0)).any():
            where = np.flatnonzero(only & (span == 0)).tolist()
            raise ConversionError(
                f"normalize divides by zero in dimensions {where}: the data never moved there; "
                "say epsilon, constant, or only"
            )
        # mean_std: y = (x - mean) / span; else y = 2 (x - low) / span - 1
        scale = span if rule == "mean_std" else span / 2
        shift = one if rule == "mean_std" else one + scale
        for line in (self._to, self._back):
            line.scale, line.shift = np.where(only, scale, 1.0), np.where(only, shift, 0.0)
        if how in _CONSTANT:
            (to_scale, to_shift), (back_scale, back_shift) = _CONSTANT[how]
            self._to.put(constant, to_scale, to_shift * one)
            self._back.put(constant, back_scale, back_shift * one)

    def encode(self, values: np.ndarray) -> np.ndarray:
        """Return normalised values (..., width)."""
        result = (values - self._to.shift) / self._to.scale
        return result if self._clip is None else np.clip(result, *self._clip)

    def decode(self, values: np.ndarray) -> np.ndarray:
        """Return what was normalised to these values (..., width)."""
        given = values if self._clip is None else np.clip(values, *self._clip)
        return given * self._back.scale + self._back.shift


class _Line:
    """By dimension: x = scale * y + shift."""

    def __init__(self, width: int) -> None:
        self.scale, self.shift = np.ones(width), np.zeros(width)

    def put(self, where: np.ndarray, scale: float, shift: np.ndarray) -> None:
        self.scale, self.shift = np.where(where, scale, self.scale), np.where(where, shift, self.shift)


def _numbers(entry: Entry, name: str, folders: Sequence[Path], width: int, padded: int | None) -> np.ndarray:
    if "values" in entry:
        found = entry["values"].get(name)
    else:
        found = _read(
            entry["file"], folders, [*entry.get("key", "").split("/"), entry.get("names", {}).get(name, name)]
        )
    if found is None:
        raise ConversionError(
            f"normalize has no {name}, which the rule {entry['rule']} needs; add it to values, or name it"
        )
    try:
        numbers = np.asarray(found, np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise ConversionError(f"normalize: expected a list of numbers as {name}, got {str(found)[:80]}") from None
    if numbers.size == padded:  # openpi's own are of the padded vector
        numbers = numbers[:width]
    if numbers.shape != (width,):
        raise ConversionError(
            f"normalize has {numbers.size} numbers as {name}, expected {width}: one for each number of the parts"
        )
    if not np.isfinite(numbers).all():
        raise ConversionError(
            f"normalize: {name} holds a number that is not finite in {np.flatnonzero(~np.isfinite(numbers))}"
        )
    return numbers


def _read(file: str, folders: Sequence[Path], words: Sequence[str]) -> Any:
    path = tables.find(file, folders)
    if path is None:
        told = ", ".join(map(str, folders)) or "no folder"
        raise ConversionError(
            f"normalize names the file {file}, which is in none of: {told}; copy it, or say where in one of these it is"
        )
    return tables.read(path, words)
