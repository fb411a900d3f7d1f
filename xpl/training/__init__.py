"""Training data of a policy, made by the same conversions as in serving.

    from xpl.training import statistics, windows
    from xpl.trajectory import open_folder

    numbers = statistics(".", config, open_folder("demos/lift_cube"), horizon=16)
    ...                                         # write them into the file that `model_io.normalize` names
    found = windows(".", config, open_folder("demos/lift_cube"), horizon=16)
    batch = found.batch([0, 7, 40])             # inputs as `predict` gets them; `found.targets` has the model's outputs

Each recorded observation goes through the adapter's `encode` (the block `model_io`, or its own), without its model.
Each recorded action goes through the inverse of its `decode`. Needs numpy, and h5py and Pillow to read a data set.
`xpl.training.lerobot` trains policies of LeRobot with it.
"""

from __future__ import annotations

from xpl.training.adapters import TrainingError, without_model
from xpl.training.numbers import statistics
from xpl.training.reading import windows
from xpl.training.windows import Windows

__all__ = ["TrainingError", "Windows", "statistics", "windows", "without_model"]
