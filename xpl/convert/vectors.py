"""Vectors of a model: parts in their order, normalised, then padded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.convert.errors import NativeError
from xpl.convert.numbers import Normalization

if TYPE_CHECKING:
    from pathlib import Path

    from xpl.convert.parts import Part


class Vector:
    """Parts, normalisation and padding of one vector.

    Args:
        entry: of `state`, or `action`, in the native block.
        parts: its parts.
        folders: where a file of statistics may lie.
        where: how errors call it.

    Attributes:
        parts: in the model's order.
        width: numbers of all parts.
        padded: numbers of the model's vector.
    """

    def __init__(self, entry: Mapping[str, Any], parts: list[Part], folders: Sequence[Path], where: str) -> None:
        self.parts = parts
        self.width = sum(item.width for item in parts)
        self.padded: int = entry.get("pad", self.width)
        self._where = where
        if self.padded < self.width:
            raise NativeError(f"{where}: padded to {self.padded} numbers, but its parts have {self.width}")
        try:
            self._numbers = Normalization(entry.get("normalize"), self.width, folders)
        except NativeError as error:
            raise NativeError(f"{where}.{error}") from None

    def normalized(self, values: np.ndarray) -> np.ndarray:
        """Return numbers (..., width) as the model gets them, (..., padded)."""
        result = self._numbers.encode(values)
        rest = self.padded - self.width
        return np.pad(result, [(0, 0)] * (result.ndim - 1) + [(0, rest)]) if rest else result

    def denormalized(self, values: np.ndarray) -> np.ndarray:
        """Return numbers (..., width) of the model's, (..., padded).

        Raises:
            NativeError: if there are more or fewer.
        """
        if values.ndim < 1 or values.shape[-1] != self.padded:
            raise NativeError(f"{self._where}: expected {self.padded} numbers, the model gave {values.shape}")
        return self._numbers.decode(values[..., : self.width])

    def cut(self, values: np.ndarray) -> Iterator[tuple[Part, np.ndarray]]:
        """Yield each part with its numbers (..., width of the part); rotations first, positions may need them."""
        start, pieces = 0, []
        for item in self.parts:
            pieces.append((item, values[..., start : start + item.width]))
            start += item.width
        yield from sorted(pieces, key=lambda piece: piece[0].kind != "rotation")
