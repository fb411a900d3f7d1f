"""Ranking of mistakes: all are tried on few questions, the good ones on more, the best on all.

A scorer decides which are good: golden pairs by the remaining difference, demonstrations by the distance of predicted
actions from demonstrated ones.
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
"""Takes numbers of mistakes and of questions; yields the answers under each mistake until the time is over."""


@dataclass(frozen=True)
class MistakeFamily:
    """Mistakes whose answers are obtained in the same way.

    Attributes:
        mistakes: the likeliest first.
        answers: yields answers under them.
        combine: takes pairs of mistakes by their numbers; returns the family in which both of each pair are undone, or
            None where they cannot be undone together. Its `pairs` are those that fit.
        pairs: of such a family, the pairs of its mistakes.
    """

    mistakes: Sequence[Mistake]
    answers: AnswerFunction
    combine: Callable[[Sequence[tuple[int, int]]], MistakeFamily | None] = lambda _pairs: None
    pairs: Sequence[tuple[int, int]] = ()


class Scorer(ABC):
    """Scores the answers under a mistake.

    Attributes:
        all_questions: the numbers of all questions.
    """

    all_questions: Sequence[int]

    @property
    @abstractmethod
    def rounds(self) -> Sequence[Sequence[int]]:
        """Questions of each round, before the remaining mistakes are tried on all questions."""

    @abstractmethod
    def select(self, results: Sequence[MistakeAnswers], questions: Sequence[int], round_number: int) -> list[int]:
        """Return the indices of the results that enter the next round, sorted.

        Args:
            results: under each mistake.
            questions: the questions.
            round_number: number of the round.
        """


@dataclass(frozen=True)
class RankingResult:
    """Results of a family.

    Attributes:
        first_round: answers of the first round, mistake by mistake.
        final_round: numbers of the mistakes that were tried on all questions, with the answers.
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
