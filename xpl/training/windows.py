"""Inputs and targets of every control step of a data set, in arrays from which batches are taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Union

import numpy as np

Values = Union[np.ndarray, "list[str]"]


@dataclass(frozen=True)
class Pixels:
    """Scaling of uint8 images to a model's input: `(bytes * span / 255 + low - mean) / std`, in float32 and this order.

    Attributes:
        span, low, mean, std: float32 arrays that broadcast over the input.
    """

    span: np.ndarray
    low: np.ndarray
    mean: np.ndarray
    std: np.ndarray

    def numbers(self, values: np.ndarray) -> np.ndarray:
        """Return the scaled values of uint8 images, float32, bit-identical to those of `encode`."""
        result: np.ndarray = (values * self.span / np.float32(255) + self.low - self.mean) / self.std
        return result


@dataclass(frozen=True)
class Windows:
    """Inputs and target outputs of a model at each of N control steps of a data set.

    Histories and batches are indexed by row, so that each observation is stored once. With torch: move `inputs`,
    `history_rows` and `targets` to the device, and index them there as `batch` does.

    Attributes:
        inputs: by input of the model, one row for each control step: (N, ...) float32, (N, ...) uint8 if `pixels` has
            the input, or a list of N texts.
        pixels: scaling of uint8 images by input; without inputs that the model reads as uint8.
        targets: (N, H, D) float32: normalised outputs of the model, oldest step first.
        padded: (N, H) bool: True before the beginning and after the end of an episode, where its first or last action
            is repeated.
        history_rows: by input with a history (N, T) int64: rows of each step's history, in its order; -1 for zeros.
        real: by input that masks the padding of a history (N, T) float32: 1 for observations, 0 for padding.
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
        """Return the inputs of B control steps, bit-identical to those that `predict` gets.

        Args:
            rows: indices of the control steps, (B,), 0 to N - 1.

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
