"""Ground truth of a simulator (`privileged`) in a trajectory: numeric arrays only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl.trajectory.names import DatasetPath

EXPERT = "expert"
"""Key of the scripted expert's action, which is not ground truth and not recorded."""
RECORDED, LEFT_OUT = "recorded", "left_out"
"""Keys of the episode's metadata below `privileged`: recorded names, and reasons of the others."""


class GroundTruth:
    """Selects the parts of the privileged observation to record: arrays with one shape in every step.

    Attributes:
        left_out: reason by name of a part that is not recorded.
    """

    def __init__(self) -> None:
        self.left_out: dict[str, str] = {}
        self._recorded: dict[DatasetPath, tuple[tuple[int, ...], np.dtype[Any]]] | None = None

    @property
    def facts(self) -> dict[str, Any]:
        """Metadata for the episode, plain data."""
        names = sorted("/".join(path[1:]) for path in self._recorded or ())
        return {RECORDED: names, LEFT_OUT: dict(sorted(self.left_out.items()))}

    def parts(self, privileged: object, step: int) -> dict[DatasetPath, np.ndarray]:
        """Return the arrays to record of a step, by path in the observation.

        Args:
            privileged: the privileged observation, None if there is none.
            step: index of the step; parts that the first step lacks are left out.
        """
        arrays = dict(self._numbers(privileged if isinstance(privileged, Mapping) else {}, (spec.Obs.PRIVILEGED,)))
        if self._recorded is None:
            self._recorded = {path: (array.shape, array.dtype) for path, array in arrays.items()}
        for path in [path for path, form in self._recorded.items() if not _fits(arrays.get(path), form)]:
            del self._recorded[path]
            why = "is not there" if path not in arrays else f"is {arrays[path].dtype} of shape {arrays[path].shape}"
            self.left_out["/".join(path[1:])] = f"{why} in step {step}, unlike before"
        for path in arrays.keys() - self._recorded.keys():
            self.left_out.setdefault("/".join(path[1:]), f"is not there before step {step}")
        return {path: arrays[path] for path in self._recorded}

    def _numbers(self, privileged: Mapping[Any, object], path: DatasetPath) -> Iterator[tuple[DatasetPath, np.ndarray]]:
        for key, value in privileged.items():
            entry_path = (*path, str(key))
            name = "/".join(entry_path[1:])
            if entry_path[1:] == (EXPERT,):
                self.left_out[name] = "is what an expert does now, which `action` has"
            elif "/" in entry_path[-1] or entry_path[-1] in ("", "."):
                self.left_out[name] = "cannot name a dataset"
            elif isinstance(value, Mapping):
                yield from self._numbers(value, entry_path)
            else:
                array = _array(value)
                if array is not None and array.size:
                    yield entry_path, array
                else:
                    self.left_out[name] = "is no array of numbers"


def _array(value: object) -> np.ndarray | None:
    try:
        array = np.asarray(value)
    except ValueError:  # lists of unequal lengths
        return None
    return array if array.dtype.kind in "biuf" else None


def _fits(array: np.ndarray | None, form: tuple[tuple[int, ...], np.dtype[Any]]) -> bool:
    return array is not None and array.shape == form[0] and np.can_cast(array.dtype, form[1], "same_kind")
