"""Changes tried one against the other: on one question, the good ones on a few, the best on all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from xpl_cli.model_io.difference import differences
from xpl_cli.model_io.explain import Explanation, Tried, explain

if TYPE_CHECKING:
    from xpl_cli.audit.offline.parity.course import Course
    from xpl_cli.audit.offline.parity.judgement import Judgement
    from xpl_cli.model_io.difference import Step

Ask = Callable[[Sequence[int], Sequence[int]], Iterator[Tried]]
"""Tries changes by their numbers on questions by theirs, as far as the time reaches."""

_FEW: Final = 3
"""Questions on which changes are tried before they are on all."""
_MOST: Final = (24, 8)
"""Changes that go on, of those tried on one question and on a few: so many that leave least, or mend most."""
_PROMISING: Final = 0.5
"""Share of the difference that a change may leave to go on."""
_INFINITE: Final = float("inf")


class Contest:
    """Which of many changes explains a difference.

    Args:
        course: the questions.
        judgement: of the adapter's answers to them.
        among: numbers of the questions that are looked at; a difference has to be among them.
    """

    def __init__(self, course: Course, judgement: Judgement, among: Sequence[int]) -> None:
        self._course = course
        self._judgement = judgement
        self._among = among
        self.before = self.remaining({number: judgement.given[number] for number in among})

    @property
    def differs(self) -> bool:
        """Whether there is anything to explain."""
        return any(share > self._judgement.allowed[part] for part, share in self.before.items())

    def held(self, count: int, ask: Ask) -> Explanation:
        """Return what explains the difference.

        Args:
            count: number of changes, the likeliest first.
            ask: tries them.
        """
        good: Sequence[int] = range(count)
        chosen = self._chosen
        for wanted, most in zip((chosen[:1], chosen), _MOST, strict=True):
            tried = list(ask(good, wanted)) if good else []
            good = [good[place] for place in self._promising(tried, wanted, most)]
        return self.explained(list(ask(good, self._among)) if good else [])

    def explained(self, tried: Sequence[Tried]) -> Explanation:
        """Return which of some changes, tried on all questions, explains the difference."""
        return explain(self.before, tried, self._judgement.tolerance)

    def remaining(self, given: Mapping[int, Sequence[Step | None]] | None) -> dict[str, float]:
        """Return how far answers to some questions are from the golden ones; steps that are not known do not count."""
        judgement = self._judgement
        if not given:
            return dict.fromkeys(judgement.spread, _INFINITE)
        return differences([judgement.golden[number] for number in given], list(given.values()), judgement.spread)

    @property
    def _chosen(self) -> list[int]:
        """The questions on which changes are tried first: one that tells much, one that is right, another one."""
        judgement = self._judgement
        worst = {number: max(self.remaining({number: judgement.given[number]}).values()) for number in self._among}
        wrong = [number for number in self._among if judgement.off[number]]
        right = [number for number in self._among if not judgement.off[number]]
        largest = max(worst[number] for number in wrong)
        telling = [number for number in wrong if worst[number] >= _PROMISING * largest]
        return list(dict.fromkeys([telling[0], *right[:1], *telling[1:], *wrong]))[:_FEW]

    def _promising(self, tried: Sequence[Tried], wanted: Sequence[int], most: int) -> list[int]:
        """Return the places of the changes that are worth more questions: that leave least, or mend most numbers."""
        judgement = self._judgement
        before = self.remaining({number: judgement.given[number] for number in self._course.with_earlier(wanted)})
        largest = max(before.values())
        left = [max(one.remaining.values()) / largest if largest < _INFINITE else _INFINITE for one in tried]
        mended = [
            sum(value > judgement.allowed[part] >= one.remaining[part] for part, value in before.items())
            for one in tried
        ]
        worth = [place for place in range(len(tried)) if left[place] <= _PROMISING or mended[place]]
        best = sorted(worth, key=lambda place: left[place])[:most]
        widest = sorted(worth, key=lambda place: -mended[place])[:most]
        return sorted({*best, *widest})
