"""Statistics of columns and cameras, per episode and per dataset, which LeRobot's policies normalise with.

Source: lerobot/datasets/compute_stats.py. Quantiles of an episode are exact here; LeRobot reads them from a
histogram. Quantiles of the dataset are step-weighted means over episodes, as in LeRobot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

QUANTILES: Final = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_FEWEST, _MOST = 100, 10_000
_SMALL, _WANTED = 300, 150

Stats = Mapping[str, list[Any]]
"""min, max, mean, std, quantiles and count, by name; nested lists of numbers."""


def of_numbers(rows: np.ndarray) -> Stats:
    """Return statistics of rows (T, *shape), over all axes but the last."""
    flat = rows.reshape(len(rows), -1) if rows.ndim < 2 else rows.reshape(-1, rows.shape[-1])
    return {**_of(flat.astype(np.float64)), "count": [len(rows)]}


def sampled_steps(length: int) -> list[int]:
    """Return the steps whose images are sampled, as many as LeRobot samples."""
    count = max(min(length, _FEWEST), min(int(length**0.75), _MOST))
    steps: list[int] = np.round(np.linspace(0, length - 1, count)).astype(int).tolist()
    return steps


def downsample(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image subsampled to about 150 pixels on the longer side, if that has 300 or more."""
    height, width = image.shape[:2]
    if max(width, height) < _SMALL:
        return image
    factor = max(width, height) // _WANTED
    return image[::factor, ::factor]


def of_images(images: Sequence[NDArray[np.uint8]]) -> Stats:
    """Return statistics of the channels of RGB images, 0..1, each (3, 1, 1)."""
    counts = np.zeros((3, 256), np.int64)
    for image in images:
        for channel in range(3):
            counts[channel] += np.bincount(image[..., channel].reshape(-1), minlength=256)
    levels = np.arange(256) / 255
    totals = counts.sum(1)
    mean = counts @ levels / totals
    std = np.sqrt(np.maximum(counts @ levels**2 / totals - mean**2, 0))
    present = [np.flatnonzero(row) for row in counts]
    values: dict[str, Any] = {
        "min": np.array([levels[row[0]] for row in present]),
        "max": np.array([levels[row[-1]] for row in present]),
        "mean": mean,
        "std": std,
    }
    for name, share in QUANTILES.items():
        values[name] = np.array(
            [levels[np.searchsorted(np.cumsum(row), share * total)] for row, total in zip(counts, totals, strict=True)]
        )
    return {**{name: value.reshape(3, 1, 1).tolist() for name, value in values.items()}, "count": [len(images)]}


def of_all(episodes: Sequence[Mapping[str, Stats]]) -> dict[str, Stats]:
    """Aggregate the statistics of episodes to those of the dataset, by feature."""
    return {name: _joined([episode[name] for episode in episodes]) for name in episodes[0]}


def _of(flat: NDArray[np.float64]) -> Stats:
    shares = np.quantile(flat, list(QUANTILES.values()), axis=0)
    return {
        "min": flat.min(0).tolist(),
        "max": flat.max(0).tolist(),
        "mean": flat.mean(0).tolist(),
        "std": flat.std(0).tolist(),
        **{name: share.tolist() for name, share in zip(QUANTILES, shares, strict=True)},
    }


def _joined(parts: Sequence[Stats]) -> Stats:
    counts = np.array([part["count"][0] for part in parts], np.float64)
    stacked = {name: np.array([part[name] for part in parts]) for name in parts[0] if name != "count"}
    weights = (counts / counts.sum()).reshape(-1, *[1] * (stacked["mean"].ndim - 1))
    mean = (stacked["mean"] * weights).sum(0)
    variance = ((stacked["std"] ** 2 + (stacked["mean"] - mean) ** 2) * weights).sum(0)
    return {
        "min": stacked["min"].min(0).tolist(),
        "max": stacked["max"].max(0).tolist(),
        "mean": mean.tolist(),
        "std": np.sqrt(variance).tolist(),
        "count": [int(counts.sum())],
        **{name: (stacked[name] * weights).sum(0).tolist() for name in QUANTILES if name in stacked},
    }
