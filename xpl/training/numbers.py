"""The numbers that `model_io.normalize` needs, of a set's own values before normalisation."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from xpl.training.adapters import without_model
from xpl.training.reading import Shown, is_told_secrets, read_all

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl.trajectory import Folder

ACTION = "action"
"""Under which the answers' numbers stand."""


def statistics(
    folder: str | os.PathLike[str],
    config: Config,
    demonstrations: Folder,
    *,
    horizon: int | None = None,
    first: int = 0,
) -> dict[str, dict[str, np.ndarray]]:
    """Return the statistics of a set's vectors, in the model's own numbers but for their normalisation.

    Each input counts every control step once. Of answers that are absolute so does each action; of those that are
    counted from something each step of each window, since the same action means other numbers there.

    Args:
        folder: the package.
        config: of the run.
        demonstrations: the set.
        horizon: as of `windows`.
        first: as of `windows`.

    Returns:
        By input, and under `action`: min, max, mean, std, q01, q99, each (width,) float32, and count (1,).

    Raises:
        TrainingError: the set does not fit the adapter.
    """
    policy = without_model(folder, config, normalized=False, images=False)
    found = read_all(Shown(policy, demonstrations, is_told_secrets(folder, config)), horizon, first)
    vectors = {
        name: values.reshape(len(values), -1)
        for name, values in found.inputs.items()
        if isinstance(values, np.ndarray) and values.dtype != np.uint8
    }
    assert policy.interface is not None  # `without_model` asks for it  # noqa: S101
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
