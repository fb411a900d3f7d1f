"""Score of mistakes by golden pairs: the difference that remains under each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl_cli.audit.offline.search.ranking import Scorer
from xpl_cli.model_io.difference import differences
from xpl_cli.model_io.explain import Explanation, TriedChange, explain

if TYPE_CHECKING:
    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.audit.offline.search.loaded_adapter import AnswersByQuestion, MistakeAnswers
    from xpl_cli.audit.offline.search.ranking import RankingResult
    from xpl_cli.audit.offline.search.session_replay import SessionReplay
    from xpl_cli.model_io.difference import Step

_FEW: Final = 3
"""Questions on which mistakes are tried before they are on all."""
_MOST: Final = (24, 8)
"""How many enter the next round, after one question and after a few: those that leave least, or fix most numbers."""
_PROMISING: Final = 0.5
"""Share of the difference that may remain for the next round."""
_INFINITE: Final = float("inf")


class GoldenPairScorer(Scorer):
    """Scores mistakes by the difference from golden pairs that they leave.

    Args:
        replay: the questions.
        judgement: of the adapter's answers to them.
        among: numbers of the questions that count; at least one differs.
    """

    def __init__(self, replay: SessionReplay, judgement: Judgement, among: Sequence[int]) -> None:
        self._replay = replay
        self._judgement = judgement
        self.all_questions = among
        self.before = self.remaining({number: judgement.answers[number] for number in among})

    @property
    def differs(self) -> bool:
        """Whether there is anything to explain."""
        return any(share > self._judgement.allowed[part] for part, share in self.before.items())

    def leaves_nothing(self, result: MistakeAnswers) -> bool:
        """Whether no difference is left under a mistake."""
        return max(self.remaining(result.answers).values()) <= self._judgement.tolerance

    def score(self, result: MistakeAnswers) -> TriedChange:
        """Return the difference that remains under a mistake."""
        return TriedChange(result.words, result.convention, self.remaining(result.answers))

    def score_pair(
        self, first: MistakeAnswers, second: MistakeAnswers, answers: AnswersByQuestion | None
    ) -> TriedChange:
        """Return the difference that remains with two mistakes undone."""
        return TriedChange(first.words, first.convention, self.remaining(answers), (second.words, second.convention))

    def explain_ranking(self, ranking: RankingResult) -> Explanation:
        """Return which mistake of a family explains the difference."""
        return self.explain_tried([self.score(result) for _, result in ranking.final_round])

    def explain_tried(self, tried: Sequence[TriedChange]) -> Explanation:
        """Return which of some mistakes, tried on all questions, explains the difference."""
        return explain(self.before, tried, self._judgement.tolerance)

    def remaining(self, answers: Mapping[int, Sequence[Step | None]] | None) -> dict[str, float]:
        """Return the differences of some answers from the golden ones; unknown steps do not count."""
        judgement = self._judgement
        if not answers:
            return dict.fromkeys(judgement.spread, _INFINITE)
        return differences([judgement.golden[number] for number in answers], list(answers.values()), judgement.spread)

    @cached_property
    def rounds(self) -> Sequence[Sequence[int]]:
        """One question, then a few: one with a large difference, one without, another one."""
        judgement = self._judgement
        largest_by_question = {
            number: max(self.remaining({number: judgement.answers[number]}).values()) for number in self.all_questions
        }
        wrong = [number for number in self.all_questions if judgement.differs[number]]
        right = [number for number in self.all_questions if not judgement.differs[number]]
        largest = max(largest_by_question[number] for number in wrong)
        informative = [number for number in wrong if largest_by_question[number] >= _PROMISING * largest]
        informative.sort(key=lambda number: (len(self._replay.with_earlier([number])), number))  # the quickest first
        chosen = list(dict.fromkeys([informative[0], *right[:1], *informative[1:], *wrong]))[:_FEW]
        return chosen[:1], chosen

    def select(self, results: Sequence[MistakeAnswers], questions: Sequence[int], round_number: int) -> list[int]:
        """Return the indices of the results that leave least, or fix most numbers."""
        judgement = self._judgement
        before = self._before(questions)
        largest = max(before.values())
        remainders = [self.remaining(one.answers) for one in results]
        left = [max(one.values()) / largest if largest < _INFINITE else _INFINITE for one in remainders]
        fixed = [
            sum(value > judgement.allowed[part] >= one[part] for part, value in before.items()) for one in remainders
        ]
        promising = [slot for slot in range(len(results)) if left[slot] <= _PROMISING or fixed[slot]]
        best = sorted(promising, key=lambda slot: left[slot])[: _MOST[round_number]]
        widest = sorted(promising, key=lambda slot: -fixed[slot])[: _MOST[round_number]]
        return sorted({*best, *widest})

    def improving(self, results: Sequence[MistakeAnswers], most: int) -> list[int]:
        """Return the indices of candidates for one of two mistakes, best first: those that lower the mean difference.

        Args:
            results: to the questions of the first round.
            most: how many to return at the most; of several on one convention with equal rests the first counts.
        """
        before = self._before(self.rounds[0])
        slots: dict[tuple[float, str], int] = {}
        for slot, one in enumerate(results):
            share = self._mean(self.remaining(one.answers)) / self._mean(before)
            if share < 1.0:
                slots.setdefault((float(f"{share:.6g}"), one.convention), slot)
        return [slot for _, slot in sorted(slots.items())][:most]

    def _mean(self, rest: Mapping[str, float]) -> float:
        """Return the mean of the remaining differences; those within the tolerance count as 0."""
        allowed = self._judgement.allowed
        return float(np.mean([max(0.0, value - allowed[part]) for part, value in rest.items()])) or 1e-12

    def _before(self, questions: Sequence[int]) -> dict[str, float]:
        return self.remaining({one: self._judgement.answers[one] for one in self._replay.with_earlier(questions)})
