"""Inputs and answers of every control step of a set, in arrays from which batches are picked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Union

import numpy as np

Values = Union[np.ndarray, "list[str]"]


@dataclass(frozen=True)
class Pixels:
    """How bytes of an image input become its numbers: `(bytes * scale + low - mean) / std`, in float32 and this order.

    Attributes:
        scale, low, mean, std: float32 arrays that broadcast over the input.
    """

    scale: np.ndarray
    low: np.ndarray
    mean: np.ndarray
    std: np.ndarray

    def numbers(self, values: np.ndarray) -> np.ndarray:
        """Return the numbers of bytes, float32, the same bits as `encode` makes."""
        result: np.ndarray = (values * self.scale + self.low - self.mean) / self.std
        return result


@dataclass(frozen=True)
class Windows:
    """What a model reads, and should answer, at each of N control steps of a set.

    Histories and batches are picked by row, so that each observation lies here once. With torch: move `inputs`, `seen`
    and `targets` to the device, and index them there as `batch` does.

    Attributes:
        inputs: by the model's name, one row for each control step: (N, ...) float32, (N, ...) uint8 where `pixels` has
            the input, or a list of N texts.
        pixels: how the bytes of an image input become its numbers; inputs whose numbers are bytes are not in it.
        targets: (N, H, D) float32: the model's normalised answers, oldest step first.
        padded: (N, H) bool: True where an episode was not yet, or no longer; its first or last action stands there.
        seen: by input with a history (N, T) int64: the rows that each step shows, in its order; -1 where zeros stand.
        real: by input that tells which observations of a history are real (N, T) float32: 1 real, 0 made up.
        starts: (E + 1,) int64: the first row of each of E episodes, and N.
    """

    inputs: Mapping[str, Values]
    pixels: Mapping[str, Pixels]
    targets: np.ndarray
    padded: np.ndarray
    history_rows: Mapping[str, np.ndarray]
    real: Mapping[str, np.ndarray]
    starts: np.ndarray

    def __len__(self) -> int:
        """Return the number of control steps."""
        return len(self.targets)

    def batch(self, rows: Sequence[int] | np.ndarray) -> dict[str, Any]:
        """Return B control steps: inputs as `predict` gets them, the same bits.

        Args:
            rows: of the control steps, (B,).

        Returns:
            By input (B, ...) arrays, (B, T, ...) where it has a history, or a list of B texts.
        """
        chosen = np.asarray(rows, np.int64)
        result: dict[str, Any] = {}
        for name, values in self.inputs.items():
            if isinstance(values, list):
                result[name] = [values[row] for row in chosen]
            else:
                result[name] = self._picked(name, values, chosen)
        return {**result, **{name: values[chosen] for name, values in self.real.items()}}

    def _picked(self, name: str, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        if name not in self.history_rows:
            return self._numbers(name, values[rows])
        seen = self.history_rows[name][rows]
        found = self._numbers(name, values[seen])
        found[seen < 0] = 0
        return found

    def _numbers(self, name: str, values: np.ndarray) -> np.ndarray:
        return self.pixels[name].numbers(values) if name in self.pixels else values
