"""Replayed episodes of a bundle: the sample, the comparison with the records, and its verdict.

There are two questions. On an equal machine, under the same versions, a policy that is declared deterministic must
repeat its episodes bit by bit. Elsewhere floating-point rounding differs, contacts amplify that, and single episodes
may end differently: there the question is how far the success rate may be from the recorded one.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.vector import INFRASTRUCTURE
from xpl_cli.evaluation.records.cells import cells
from xpl_cli.evaluation.statistics.intervals import (
    CONFIDENCE,
    Interval,
    PairedCounts,
    clopper_pearson,
    mcnemar,
    newcombe_paired,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from xpl_cli.evaluation.records.model import EpisodeRecord
    from xpl_cli.evaluation.records.records import Run

MARGIN = 0.1
"""Success rates agree if they surely differ by no more than this, on machines that need not repeat bit by bit."""


class ReplayMatch(StrEnum):
    """How a replayed episode compares with its record."""

    SAME = "same"
    """Every state is the same."""
    OUTCOME = "outcome"
    """Other states, or none recorded; it succeeds or fails as recorded."""
    DIFFERENT = "different"
    """It succeeds where it failed, or fails where it succeeded."""
    INFRASTRUCTURE_ERROR = "infrastructure_error"
    """It ended with an infrastructure error here: nothing can be compared."""


class ReplayVerdict(StrEnum):
    """The verdict of a sample."""

    AGREES = "agrees"
    DISAGREES = "disagrees"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class ReplayPair:
    """An episode as it was recorded, and as it came out here.

    Attributes:
        recorded, replayed: its final lines.
        is_equal_machine: whether facts of both machines are the same.
    """

    recorded: EpisodeRecord
    replayed: EpisodeRecord
    is_equal_machine: bool

    @property
    def match(self) -> ReplayMatch:
        """How the two compare."""
        old, new = self.recorded, self.replayed
        if new.failure == INFRASTRUCTURE:
            return ReplayMatch.INFRASTRUCTURE_ERROR
        if old.success != new.success:
            return ReplayMatch.DIFFERENT
        is_same = old.digest is not None and old.digest == new.digest
        return ReplayMatch.SAME if is_same else ReplayMatch.OUTCOME

    def as_json(self, run: str) -> dict[str, Any]:
        """Return the pair as in a verification."""
        keys = ("success", "score", "end_reason", "steps", "digest", "failure")
        return {
            "run": run,
            **{key: getattr(self.recorded, key) for key in ("index", "task", "setting", sdk.Deploy.SEED)},
            "match": self.match.value,
            "equal_machine": self.is_equal_machine,
            "recorded": {key: getattr(self.recorded, key) for key in keys},
            "replayed": {key: getattr(self.replayed, key) for key in keys} | {"error": self.replayed.error},
        }


@dataclass(frozen=True)
class SampleResult:
    """The result of a sample, for all episodes.

    Attributes:
        verdict: whether the record agrees with the replay.
        sentence: why.
        counts: episodes of the sample by match.
        differing: share of all episodes that would end differently here, 95 % interval; None without any to compare.
        change: difference of the success rate here (below 0: lower), 95 % interval.
    """

    verdict: ReplayVerdict
    sentence: str
    counts: Mapping[str, int]
    differing: Interval | None = None
    change: Interval | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the result as in a verification."""
        return {
            "verdict": self.verdict.value,
            "sentence": self.sentence,
            "counts": dict(self.counts),
            "confidence": CONFIDENCE,
            "differing": None if self.differing is None else list(self.differing),
            "change": None if self.change is None else list(self.change),
        }


def draw(runs: Sequence[Run], count: int, seed: int) -> list[tuple[Run, int]]:
    """Return a random sample of the episodes that count, in the order of runs and plans.

    Args:
        runs: all runs of a bundle.
        count: episodes to draw, at most.
        seed: of the draw. The maker of the bundle must not know it beforehand.
    """
    episodes = [(number, index) for number, run in enumerate(runs) for index in eligible(run)]
    chosen = random.Random(seed).sample(episodes, min(count, len(episodes)))  # noqa: S311 - a sample, no secret
    return [(runs[number], index) for number, index in sorted(chosen)]


def eligible(run: Run) -> list[int]:
    """Return the episodes of a run that count, without those that ended with an infrastructure error."""
    lines = (line for cell in cells(run) for line in cell.counted)
    return [line.index for line in lines if line.failure != INFRASTRUCTURE]


def judge(pairs: Sequence[ReplayPair], total: int, *, deterministic: bool) -> SampleResult:
    """Return the result of a sample.

    Args:
        pairs: the sample.
        total: episodes that it was drawn from.
        deterministic: whether the policy declares that it repeats itself.
    """
    counts = Counter(pair.match.value for pair in pairs)
    compared = [pair for pair in pairs if pair.match is not ReplayMatch.INFRASTRUCTURE_ERROR]
    if not compared:
        return SampleResult(ReplayVerdict.UNDECIDED, "no episode ran to its end here", counts)
    broken = [pair for pair in compared if deterministic and _is_broken(pair)]
    if broken:
        return SampleResult(
            ReplayVerdict.DISAGREES,
            f"{len(broken)} of {len(compared)} episodes have other states than recorded, on a machine with equal facts "
            f"and with a policy that is declared deterministic; the first is {_name(broken[0])}",
            counts,
        )
    return _judge_by_outcome(compared, total, counts)


def _is_broken(pair: ReplayPair) -> bool:
    """Return whether an episode should have repeated itself and has not."""
    return pair.is_equal_machine and pair.recorded.digest is not None and pair.match is not ReplayMatch.SAME


def _judge_by_outcome(compared: Sequence[ReplayPair], total: int, counts: Mapping[str, int]) -> SampleResult:
    outcomes = Counter((bool(pair.recorded.success), bool(pair.replayed.success)) for pair in compared)
    pairs = PairedCounts(outcomes[True, True], outcomes[True, False], outcomes[False, True], outcomes[False, False])
    flips = counts.get(ReplayMatch.DIFFERENT.value, 0)
    is_all = len(compared) == total
    share = flips / len(compared)
    differing = Interval(share, share) if is_all else clopper_pearson(flips, len(compared))
    gap = newcombe_paired(pairs)
    change = Interval(gap.value, gap.value) if is_all else gap.interval
    alike = counts.get(ReplayMatch.SAME.value, 0)
    summary = f"{len(compared) - flips} of {len(compared)} episodes come out as recorded, {alike} of them bit by bit"
    if is_all:
        bound = "these are all of them"
    else:
        bound = f"with {CONFIDENCE:.0%} confidence at most {differing.high:.0%} of all {total} would not"
    if not flips:
        return SampleResult(ReplayVerdict.AGREES, f"{summary}; {bound}", counts, differing, change)
    rates = f"the success rate here is {change.low:+.0%} to {change.high:+.0%} from the recorded one"
    sentence = f"{summary}; {bound}, and {rates}"
    if mcnemar(pairs) < 1 - CONFIDENCE:
        return SampleResult(
            ReplayVerdict.DISAGREES, f"{sentence}: more than chance explains", counts, differing, change
        )
    if max(-change.low, change.high) <= MARGIN:
        return SampleResult(
            ReplayVerdict.AGREES, f"{sentence}: no farther than {MARGIN:.0%}", counts, differing, change
        )
    return SampleResult(ReplayVerdict.UNDECIDED, f"{sentence}: a larger sample would decide", counts, differing, change)


def _name(pair: ReplayPair) -> str:
    record = pair.recorded
    return f"episode {record.index} ({record.task}, {record.setting}, seed {record.seed})"


def disagreements(pairs: Iterable[ReplayPair]) -> list[str]:
    """Return a sentence for each episode that ended differently, or could not be run."""
    words = {True: "succeeded", False: "failed", None: "had no outcome"}
    sentences = []
    for pair in pairs:
        if pair.match is ReplayMatch.DIFFERENT:
            old, new = words[pair.recorded.success], words[pair.replayed.success]
            sentences.append(f"{_name(pair)} {old} in the record, and {new} here ({pair.replayed.end_reason})")
        elif pair.match is ReplayMatch.INFRASTRUCTURE_ERROR:
            sentences.append(f"{_name(pair)} ended with an infrastructure error here: {pair.replayed.error}")
    return sentences
