"""Vectors of a model: parts in their order, normalised, then padded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl.conventions.joint_order import check_joints
from xpl.conventions.normalization import Normalization
from xpl.convert.parts import part
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from xpl.catalogue.part import Part
    from xpl.contract import Entry
    from xpl.embodiment import Embodiment


class Vector:
    """Parts, normalisation and padding of one vector.

    Args:
        entry: of `state`, or `action`, in the model_io block.
        embodiment: the robot.
        folders: where a file of statistics may lie.
        where: how errors call it.

    Attributes:
        parts: in the model's order.
        width: numbers of all parts.
        padded: numbers of the model's vector.
    """

    def __init__(self, entry: Entry, embodiment: Embodiment, folders: Sequence[Path], where: str) -> None:
        self._where = where
        try:
            self.parts = [part(item, embodiment) for item in entry["parts"]]
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
                f"{where}.pad is {self.padded}, but its parts have {self.width} numbers; say at least that"
            )
        try:
            self._numbers = Normalization(entry.get("normalize"), self.width, folders, self.padded)
        except ConversionError as error:
            raise ConversionError(f"{where}.{error}") from None

    def normalized(self, values: np.ndarray) -> np.ndarray:
        """Return numbers (..., width) as the model gets them, (..., padded)."""
        result = self._numbers.encode(values)
        rest = self.padded - self.width
        return np.pad(result, [(0, 0)] * (result.ndim - 1) + [(0, rest)]) if rest else result

    def denormalized(self, values: np.ndarray) -> np.ndarray:
        """Return numbers (..., width) of the model's, (..., padded).

        Raises:
            ConversionError: if there are more or fewer.
        """
        if values.ndim < 1 or values.shape[-1] != self.padded:
            raise ConversionError(
                f"{self._where}: expected steps of {self.padded} numbers, the model gave the shape {values.shape}; "
                "mend its parts or pad"
            )
        kept = values[..., : self.width]
        if not np.isfinite(kept).all():
            raise ConversionError(f"{self._where}: the model gave a number that is not finite")
        return self._numbers.decode(kept)

    def cut(self, values: np.ndarray) -> Iterator[tuple[Part, np.ndarray]]:
        """Yield each part with its numbers (..., width of the part); rotations first, positions may need them."""
        start, pieces = 0, []
        for item in self.parts:
            pieces.append((item, values[..., start : start + item.width]))
            start += item.width
        yield from sorted(pieces, key=lambda piece: piece[0].kind != "rotation")
