"""Effect sizes: how much a change of observations changes an answer, as a share of the spread of the policy's answers.

A tolerance in radians or metres says nothing about a policy that moves by a tenth of a millimetre. So effects are
measured against each other, on the scale of the answers that one experiment brought.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from xpl_cli.audit.served.compare import is_answer_list, same

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

WEAK = 0.25
"""Share of another effect below which one is weak: the newest observation counts less than a quarter of it."""
NEGLIGIBLE = 1e-3
"""Share of another effect below which one is negligible."""


class Scale:
    """Spread of the answers of one experiment, for each key of the action.

    Args:
        answers: of the experiment: chunks, lists of chunks, or errors, which have no place on a scale.
    """

    def __init__(self, answers: Iterable[object]) -> None:
        columns: dict[str, list[np.ndarray]] = defaultdict(list)
        for answer in answers:
            for key, values in _columns(answer):
                columns[key].append(values)
        self._spread = {key: _spread(values) for key, values in columns.items()}

    def effect(self, first: object, second: object) -> float:
        """Return how far apart two answers are: 0 for equal ones up to rounding, 1 for two that nothing lies beyond.

        Two that cannot be compared, such as an error and an action, are infinitely far apart.
        """
        if same(first, second):
            return 0.0
        one, other = dict(_columns(first)), dict(_columns(second))
        if one.keys() != other.keys() or not one or any(np.shape(one[key]) != np.shape(other[key]) for key in one):
            return np.inf
        return max(
            (
                float(np.abs(one[key] - other[key]).max()) / self._spread[key]
                for key in one
                if self._spread.get(key, 0.0) and not same(one[key], other[key])
            ),
            default=0.0,
        )


def is_weak(effect: float, other: float) -> bool:
    """Tell whether an effect is weak relative to another one, which must be positive."""
    return other > 0 and effect < WEAK * other


def is_negligible(effect: float, other: float) -> bool:
    """Tell whether an effect is negligible relative to another one, which must be positive."""
    return other > 0 and effect <= NEGLIGIBLE * other


def _columns(answer: object) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the values of a chunk, or of the first chunk of a batch, by key: (H, D)."""
    if not is_answer_list(answer):
        return
    chunk = answer[0] if isinstance(answer[0], (list, tuple)) else answer
    if all(isinstance(step, dict) and step.keys() == chunk[0].keys() for step in chunk):
        for key in chunk[0]:
            rows = [np.ravel(step[key]) for step in chunk]
            if len({row.shape for row in rows}) == 1 and rows[0].dtype.kind in "biuf":
                yield key, np.stack(rows).astype(np.float64)


def _spread(values: list[np.ndarray]) -> float:
    if len({value.shape for value in values}) != 1:
        return 0.0
    return float(np.ptp(np.stack(values), axis=0).max())
