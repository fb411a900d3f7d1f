"""Statistics of a data set for `model_io.normalize`."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from xpl.training.adapters import without_model
from xpl.training.reading import RecordedSet, read_all, uses_privileged

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl.trajectory import Folder

ACTION = "action"
"""Key of the statistics of actions."""


def statistics(
    folder: str | os.PathLike[str],
    config: Config,
    demonstrations: Folder,
    *,
    horizon: int | None = None,
    first: int = 0,
) -> dict[str, dict[str, np.ndarray]]:
    """Return the statistics of a data set's vectors, in the model's units before normalisation.

    Each input counts every control step once. So does each absolute action; of delta actions each step of each window
    counts, because the values depend on the window.

    Args:
        folder: folder of the package.
        config: configuration of the run.
        demonstrations: the data set.
        horizon: action horizon, see `windows`.
        first: see `windows`.

    Returns:
        By input, and under `action`: min, max, mean, std, q01, q99, each (width,) float32, and count (1,).

    Raises:
        TrainingError: the data set does not fit the adapter.
    """
    policy = without_model(folder, config, normalized=False, images=False)
    found = read_all(RecordedSet(policy, demonstrations, uses_privileged(folder, config)), horizon, first)
    vectors = {
        name: values.reshape(len(values), -1)
        for name, values in found.inputs.items()
        if isinstance(values, np.ndarray) and values.dtype != np.uint8
    }
    assert policy.interface is not None  # `without_model` requires it  # noqa: S101
    answers = found.targets if policy.interface.action.is_relative else found.targets[:, [-min(first, 0)]]
    padded = found.padded if policy.interface.action.is_relative else found.padded[:, [-min(first, 0)]]
    vectors[ACTION] = answers[~padded]
    return {name: _of(values) for name, values in vectors.items()}


def _of(rows: np.ndarray) -> dict[str, np.ndarray]:
    values = rows.astype(np.float64)
    low, high = np.quantile(values, [0.01, 0.99], axis=0)
    made = {
        "min": values.min(0),
        "max": values.max(0),
        "mean": values.mean(0),
        "std": values.std(0),
        "q01": low,
        "q99": high,
        "count": np.array([len(values)]),
    }
    return {name: numbers.astype(np.float32) for name, numbers in made.items()}
