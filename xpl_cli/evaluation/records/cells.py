"""Which recorded episodes count, and for what: the cells of a run, one for each task and setting."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.evaluation.records.records import Line, Slot, slots
from xpl_cli.evaluation.runs.stopping import stopping_point
from xpl_cli.evaluation.statistics.intervals import Estimate, Interval, Pairs, bootstrap, exact, wilson

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from xpl_cli.evaluation.records.records import Run

INFRASTRUCTURE: Final = "infrastructure"
FAILURES: Final = ("task", "policy", INFRASTRUCTURE)
METHODS: Final[dict[str, Callable[[int, int], Interval]]] = {
    "wilson": lambda successes, count: wilson(successes / count, count),
    "exact": exact,
}
"""Intervals of a success rate, by name."""


@dataclass(frozen=True)
class Cell:
    """Episodes of one task in one setting.

    Attributes:
        task, setting, dimension, frozen: as in the plan.
        planned: number of seeds.
        counted: final lines, in the order of the plan.
        beyond: number of final lines that do not count, because the cell had ended before them.
        ended: whether its success rate was known well enough before all seeds were played.
    """

    task: str
    setting: str
    dimension: str | None
    frozen: bool
    planned: int
    counted: tuple[Line, ...]
    beyond: int
    ended: bool

    @property
    def unplayed(self) -> int:
        """Number of episodes that are still to come."""
        return 0 if self.ended else self.planned - len(self.counted)

    @property
    def outcomes(self) -> list[bool]:
        """Whether each episode succeeded that counts for the success rate."""
        return [found for found in map(outcome, self.counted) if found is not None]

    @property
    def scores(self) -> list[float]:
        """Scores of the episodes that have one."""
        return [found for found in map(score, self.counted) if found is not None]

    @property
    def by_seed(self) -> dict[int, bool]:
        """Seed to whether the episode succeeded, of those that count for the success rate."""
        told = ((line[sdk.Deploy.SEED], outcome(line)) for line in self.counted)
        return {seed: found for seed, found in told if found is not None}

    def failed(self, kind: str) -> int:
        """Return the number of episodes whose failure is of this class."""
        return sum(line["failure"] == kind for line in self.counted)

    def success_rate(self, method: str) -> Estimate | None:
        """Return the success rate, its interval by one of METHODS; None if no episode has a success to speak of."""
        outcomes = self.outcomes
        if not outcomes:
            return None
        return Estimate(sum(outcomes) / len(outcomes), METHODS[method](sum(outcomes), len(outcomes)))

    def mean_score(self) -> Estimate | None:
        """Return the mean score; None if no episode has one."""
        scores = self.scores
        return Estimate(sum(scores) / len(scores), bootstrap(scores)) if scores else None


def outcome(line: Mapping[str, Any]) -> bool | None:
    """Return whether an episode succeeded, or None if it counts neither way."""
    if line["failure"] == "policy":
        return False
    return None if line["failure"] == INFRASTRUCTURE else line["success"]


def score(line: Mapping[str, Any]) -> float | None:
    """Return an episode's score, or None if it has none; a policy that failed before there was one has 0."""
    if line["failure"] == INFRASTRUCTURE:
        return None
    found: float | None = line["score"]
    return 0.0 if found is None and line["failure"] == "policy" else found


def matched(first: Mapping[Any, bool], second: Mapping[Any, bool]) -> Pairs:
    """Return how often both, one or none succeeded, of the cases that two have in common."""
    counts = Counter((first[case], second[case]) for case in first.keys() & second.keys())
    return Pairs(counts[True, True], counts[True, False], counts[False, True], counts[False, False])


def cells(run: Run) -> list[Cell]:
    """Return the cells of a run in the order of its plan."""
    places: dict[int, list[Slot]] = defaultdict(list)
    for slot in slots(run.plan):
        places[slot.cell].append(slot)
    width = run.plan.get("until_width")
    return [
        _cell(entry, [run.finals.get(slot.index) for slot in places[number]], width)
        for number, entry in enumerate(run.plan["cells"])
    ]


def _cell(entry: Mapping[str, Any], finals: Sequence[Line | None], width: float | None) -> Cell:
    played = [line for line in finals if line is not None]
    point = None
    if width is not None:
        leading = takewhile(lambda line: line is not None, finals)
        point = stopping_point((outcome(line) for line in leading if line is not None), width)
    counted = tuple(played if point is None else played[:point])
    return Cell(
        task=entry["task"],
        setting=entry["setting"],
        dimension=entry["dimension"],
        frozen=entry["frozen"],
        planned=len(finals),
        counted=counted,
        beyond=len(played) - len(counted),
        ended=point is not None,
    )
