"""Mistakes tried one against the other: on few questions first, the good ones on more, the best on all.

What is good a ruler says: golden pairs by what is left of a difference, demonstrations by how near predicted actions
come to those that were done.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xpl.catalogue import Mistake
    from xpl_cli.audit.offline.search.loaded_adapter import MistakeAnswers

AnswerFunction = Callable[[Sequence[int], Sequence[int]], Iterator["MistakeAnswers"]]
"""Yields the answers under mistakes by their numbers, the first, to questions by theirs, the second, as far as the time
reaches."""


@dataclass(frozen=True)
class MistakeFamily:
    """Mistakes whose answers are had in one way.

    Attributes:
        mistakes: the likeliest first.
        ask: yields answers under them.
        both: of pairs of mistakes by their numbers, the family in which both of each are undone; None where they cannot
            be undone together. It has the pairs that fit, `numbers`.
        numbers: of such a family, the pairs of its mistakes.
    """

    mistakes: Sequence[Mistake]
    answers: AnswerFunction
    combine: Callable[[Sequence[tuple[int, int]]], MistakeFamily | None] = lambda _pairs: None
    pairs: Sequence[tuple[int, int]] = ()


class Scorer(ABC):
    """Says how good the answers under a mistake are.

    Attributes:
        all_questions: the numbers of all questions.
    """

    all_questions: Sequence[int]

    @property
    @abstractmethod
    def rounds(self) -> Sequence[Sequence[int]]:
        """Questions on which mistakes are tried, round by round, before those that are left are tried on all."""

    @abstractmethod
    def select(self, results: Sequence[MistakeAnswers], questions: Sequence[int], round_number: int) -> list[int]:
        """Return the places of those that are worth the next round, sorted.

        Args:
            results: under each mistake.
            questions: the questions.
            round_number: number of the round.
        """


@dataclass(frozen=True)
class RankingResult:
    """What became of a family.

    Attributes:
        first: what was answered in the first round, mistake by mistake.
        last: numbers of the mistakes that were tried on all questions, and what was answered.
    """

    first_round: Sequence[MistakeAnswers]
    final_round: Sequence[tuple[int, MistakeAnswers]]


def rank(family: MistakeFamily, scorer: Scorer) -> RankingResult:
    """Try all mistakes of a family."""
    remaining: Sequence[int] = range(len(family.mistakes))
    first_round: list[MistakeAnswers] = []
    for round_number, questions in enumerate(scorer.rounds):
        results = list(family.answers(remaining, questions)) if remaining else []
        first_round = results if round_number == 0 else first_round
        remaining = [remaining[slot] for slot in scorer.select(results, questions, round_number)]
    final_round = list(
        zip(remaining, family.answers(remaining, scorer.all_questions) if remaining else (), strict=False)
    )
    return RankingResult(first_round, final_round)
