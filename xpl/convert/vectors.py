"""Vectors of a model: parts in order, normalised, then padded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl.conventions.joint_order import check_joints
from xpl.conventions.normalization import Normalization
from xpl.convert.parts import make_part
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from xpl.catalogue.part import Part
    from xpl.contract import Entry
    from xpl.embodiment import Embodiment


class ModelVector:
    """Parts, normalisation and padding of one vector.

    Args:
        entry: an entry of `state`, or `action`, of the model_io block.
        embodiment: the robot.
        folders: folders that are searched for statistics files.
        where: its name in errors.

    Attributes:
        parts: in the model's order.
        width: number of values of all parts.
        padded: number of values of the model's vector.
    """

    def __init__(self, entry: Entry, embodiment: Embodiment, folders: Sequence[Path], where: str) -> None:
        self._where = where
        try:
            self.parts = [make_part(item, embodiment) for item in entry["parts"]]
            check_joints(self.parts)
        except ConversionError as error:
            raise ConversionError(f"{where}, {error}") from None
        for index, item in enumerate(self.parts):
            if item.kind == "fill":  # there may be several
                item.label = f"{item.label} {index}"
        self.width = sum(item.width for item in self.parts)
        self.padded: int = entry.get("pad", self.width)
        if self.padded < self.width:
            raise ConversionError(
                f"{where}.pad is {self.padded}, but its parts have {self.width} values; pad to at least that"
            )
        try:
            self._numbers = Normalization(entry.get("normalize"), self.width, folders, self.padded)
        except ConversionError as error:
            raise ConversionError(f"{where}.{error}") from None

    def normalize(self, values: np.ndarray) -> np.ndarray:
        """Return normalised and padded values (..., padded) of values (..., width)."""
        result = self._numbers.encode(values)
        rest = self.padded - self.width
        return np.pad(result, [(0, 0)] * (result.ndim - 1) + [(0, rest)]) if rest else result

    def denormalize(self, values: np.ndarray) -> np.ndarray:
        """Return the values (..., width) of a model's vector (..., padded).

        Raises:
            ConversionError: the last axis has another size, or a value is not finite.
        """
        if values.ndim < 1 or values.shape[-1] != self.padded:
            raise ConversionError(
                f"{self._where}: expected steps of {self.padded} numbers, the model gave the shape {values.shape}; "
                "fix its parts or pad"
            )
        values_of_parts = values[..., : self.width]
        if not np.isfinite(values_of_parts).all():
            raise ConversionError(f"{self._where}: the model gave a number that is not finite")
        return self._numbers.decode(values_of_parts)

    def split(self, values: np.ndarray) -> Iterator[tuple[Part, np.ndarray]]:
        """Yield (part, values (..., width of the part)); rotations first, because positions may need them."""
        start, pieces = 0, []
        for item in self.parts:
            pieces.append((item, values[..., start : start + item.width]))
            start += item.width
        yield from sorted(pieces, key=lambda piece: piece[0].kind != "rotation")
