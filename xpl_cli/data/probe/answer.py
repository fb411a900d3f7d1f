"""Answers of the probe: a value with evidence and margin, or unknown with what would determine it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

MARGIN: Final = 1.5
"""Least ratio of the second-best error to the best, chosen on the datasets of tests/data/probe/probe_datasets.py."""

MOST_MARGIN: Final = 1000.0
"""Margins are reported up to this value."""


@dataclass(frozen=True)
class ProbeAnswer:
    """The probe's answer for one convention.

    Attributes:
        topic: of the convention: `rate`, `reference`, `rotation form`; terms of model_io.schema.json where it has one.
        subject: a column, a part of one (`action[0:7]`), a camera, or `set`.
        value: the convention; None where it is unknown.
        evidence: one sentence with the figure that supports the value; why, if it is unknown.
        margin: how many times worse the second best explains the data; None where there is no second.
        second: the second best.
        needs: what would determine an unknown value.
        declared: the dataset states the value itself, and the probe did not measure it.
    """

    topic: str
    subject: str
    value: Any
    evidence: str
    margin: float | None = None
    second: str | None = None
    needs: str | None = None
    declared: bool = False

    @property
    def is_known(self) -> bool:
        """Whether there is a value."""
        return self.value is not None

    def document(self) -> dict[str, Any]:
        """Return the answer as JSON values."""
        margin = None if self.margin is None else round(min(self.margin, MOST_MARGIN), 2)
        return {**vars(self), "margin": margin}


def unknown(topic: str, subject: str, why: str, needs: str) -> ProbeAnswer:
    """Return an answer without a value: why it is unknown, and what would determine it."""
    return ProbeAnswer(topic, subject, None, why, needs=needs)


@dataclass(frozen=True)
class HypothesisRanking:
    """Hypotheses ranked by error, and the best value of each facet.

    Attributes:
        errors: the error of each hypothesis, which is a tuple of (facet, value) pairs.
        floor: errors below it count as equal.
    """

    errors: Mapping[tuple[tuple[str, Any], ...], float]
    floor: float = 1e-6
    _best: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    @property
    def best(self) -> dict[str, Any]:
        """The values of the best hypothesis; of equal ones the first."""
        if not self._best:
            least = min(self.errors.values())
            winner = next(key for key, error in self.errors.items() if error <= max(least, self.floor))
            self._best.update(dict(winner))
        return self._best

    @property
    def least(self) -> float:
        """The error of the best."""
        return min(self.errors.values())

    def judge(self, facet: str) -> tuple[Any, float | None, Any]:
        """Return the best value of a facet, its margin over the best hypothesis with another value, and that value.

        Returns:
            the margin is None where no hypothesis has another value.
        """
        value = self.best[facet]
        others = {dict(key).get(facet): error for key, error in reversed(self.ranked()) if dict(key)[facet] != value}
        if not others:
            return value, None, None
        second = min(others, key=lambda name: others[name])
        own = min(error for key, error in self.errors.items() if dict(key)[facet] == value)
        return value, max(others[second], self.floor) / max(own, self.floor), second

    def ranked(self) -> list[tuple[tuple[tuple[str, Any], ...], float]]:
        """Return the hypotheses with their errors, best first."""
        return sorted(self.errors.items(), key=lambda entry: entry[1])


def is_decisive(margin: float | None) -> bool:
    """Tell whether a margin is large enough for an answer."""
    return margin is None or (math.isfinite(margin) and margin >= MARGIN) or margin == math.inf
