"""The comparison of two runs, as spec/v1/comparison.schema.json has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from xpl_cli.evaluation.statistics.documents import JsonDocument

if TYPE_CHECKING:
    from xpl_cli.evaluation.statistics.intervals import Interval
    from xpl_cli.evaluation.statistics.run_differences import RunDifference


@dataclass(frozen=True)
class ComparisonMethods:
    """How a comparison is computed."""

    test: str = "mcnemar_exact"
    interval: str = "newcombe_paired"
    score: str = "bootstrap"
    correction: str = "holm"


@dataclass(frozen=True)
class ComparedRun:
    """One of the two runs: its folder, its name, and parts of its plan."""

    folder: str
    run: str
    policy: str
    checkpoint: str | None
    environment: str
    embodiment: str
    action_type: str


@dataclass(frozen=True)
class ComparisonRow:
    """The comparison on one task and setting, or on all.

    Attributes:
        task, setting: None for all.
        pairs: number of common episodes.
        both, only_first, only_second, neither: numbers of pairs in which these succeeded.
        first_rate, second_rate: success rates.
        difference, interval: second minus first.
        p_value: of "neither is better".
        score_difference, score_interval: of the mean scores; None without scores.
        adjusted_p_value: corrected for the number of rows; None for all together.
    """

    task: str | None
    setting: str | None
    pairs: int
    both: int
    only_first: int
    only_second: int
    neither: int
    first_rate: float
    second_rate: float
    difference: float
    interval: Interval
    p_value: float
    score_difference: float | None
    score_interval: Interval | None
    adjusted_p_value: float | None = None


@dataclass(frozen=True)
class UnpairedEpisodes:
    """Episodes of each run that have no partner that counts."""

    first: int
    second: int


@dataclass(frozen=True)
class Comparison(JsonDocument):
    """Two runs on their common episodes.

    Attributes:
        first, second: the runs.
        confidence, methods: of all figures.
        differences: between the runs besides the policy.
        left_out: episodes without a partner.
        same_trajectories: pairs with equal states.
        known_layouts: pairs in which both records have the layout.
        cells, overall: the rows.
        verdict: the answer in a sentence.
        notes: what the data do not show, in sentences.
    """

    schema: ClassVar[str] = "xpl.comparison/1"

    first: ComparedRun
    second: ComparedRun
    confidence: float
    methods: ComparisonMethods
    differences: Sequence[RunDifference]
    left_out: UnpairedEpisodes
    same_trajectories: int
    known_layouts: int
    cells: Sequence[ComparisonRow]
    overall: ComparisonRow
    verdict: str = ""
    notes: Sequence[str] = ()

    @property
    def names(self) -> tuple[str, str]:
        """What to call the two: their policies, or their folders where these are equal."""
        one, other = self.first, self.second
        return (one.policy, other.policy) if one.policy != other.policy else (one.folder, other.folder)
