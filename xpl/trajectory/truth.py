"""What a simulator tells a privileged policy, as a trajectory keeps it: its numbers, and neither words nor answers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl.trajectory.names import Place

EXPERT = "expert"
"""Where a benchmark's environment tells what its own expert does: no fact of the world, but the answer."""
RECORDED, LEFT_OUT = "recorded", "left_out"
"""What an episode's facts say below `privileged`: the names that are there, and by name why another one is not."""


class Truth:
    """Chooses, step by step, what of the privileged observation is kept: numbers of one shape that each step has.

    Attributes:
        left_out: by name why something that was told is not kept.
    """

    def __init__(self) -> None:
        self.left_out: dict[str, str] = {}
        self._kept: dict[Place, tuple[tuple[int, ...], np.dtype[Any]]] | None = None

    @property
    def facts(self) -> dict[str, Any]:
        """What the facts of the episode say of it, plain data."""
        names = sorted("/".join(path[1:]) for path in self._kept or ())
        return {RECORDED: names, LEFT_OUT: dict(sorted(self.left_out.items()))}

    def parts(self, told: object, step: int) -> dict[Place, np.ndarray]:
        """Return what is kept of a step, by its part of the observation.

        Args:
            told: the privileged observation, None where there is none.
            step: its number; what is not there from the first one on is left out.
        """
        found = dict(self._numbers(told if isinstance(told, Mapping) else {}, (spec.Obs.PRIVILEGED,)))
        if self._kept is None:
            self._kept = {path: (array.shape, array.dtype) for path, array in found.items()}
        for path in [path for path, form in self._kept.items() if not _fits(found.get(path), form)]:
            del self._kept[path]
            why = "is not there" if path not in found else f"is {found[path].dtype} of shape {found[path].shape}"
            self.left_out["/".join(path[1:])] = f"{why} in step {step}, unlike before"
        for path in found.keys() - self._kept.keys():
            self.left_out.setdefault("/".join(path[1:]), f"is not there before step {step}")
        return {path: found[path] for path in self._kept}

    def _numbers(self, told: Mapping[Any, object], path: Place) -> Iterator[tuple[Place, np.ndarray]]:
        for key, value in told.items():
            place = (*path, str(key))
            name = "/".join(place[1:])
            if place[1:] == (EXPERT,):
                self.left_out[name] = "is what an expert does now, which `action` has"
            elif "/" in place[-1] or place[-1] in ("", "."):
                self.left_out[name] = "cannot name a dataset"
            elif isinstance(value, Mapping):
                yield from self._numbers(value, place)
            else:
                array = _array(value)
                if array is not None and array.size:
                    yield place, array
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
