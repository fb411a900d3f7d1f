"""Demonstrations as a ruler: how near predicted actions come to those that were done, under each mistake."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache
from typing import TYPE_CHECKING, Final

from xpl_cli.audit.offline.demonstrations.certainty import Margin, margin
from xpl_cli.audit.offline.demonstrations.episodes import select_few
from xpl_cli.audit.offline.search.ranking import Scorer as SearchRuler

if TYPE_CHECKING:
    from xpl_cli.audit.offline.demonstrations.action_errors import ActionErrors, Chunks, ErrorMetric
    from xpl_cli.audit.offline.search.loaded_adapter import MistakeAnswers
    from xpl_cli.model_io.pairs import Chunk

_PROMISING: Final = 0.93
"""What may be left of the error on a few questions to be tried on all."""
_MOST: Final = 32
"""Mistakes that are tried on all questions."""
_HARDLY: Final = 0.25
"""Mistakes under which arms are led less far than by this share of what was done are not named: who hardly moves is
nearer than who moves wrongly, whatever is wrong."""


class DemonstrationScorer(SearchRuler):
    """Which of many mistakes brings predicted actions nearer to those that were done.

    Args:
        ruler: measures against these.
        given: the adapter's own answers to all questions, empty where it refused one.
        refused: the numbers of those.

    Attributes:
        first: words, convention and share of the error of all that were tried on a few questions.
        count: how many were tried.
    """

    def __init__(self, ruler: ErrorMetric, given: Sequence[Chunk], refused: Collection[int]) -> None:
        self._ruler, self._given, self._refused = ruler, given, refused
        self._own: dict[tuple[int, ...], ActionErrors] = {}
        self._few = select_few(ruler.session.question_steps)
        self.everything = list(range(len(given)))
        self.first_round: list[tuple[str, str, float]] = []
        self.count = 0

    def set_baseline(self, own: Chunks | None, wanted: Sequence[int]) -> None:
        """Hold what follows against answers of the adapter that were asked alike; None for those that it served."""
        if own is None:
            self._own.clear()
        else:
            self._own[tuple(wanted)] = self._ruler.errors(own, wanted)

    @property
    def rounds(self) -> Sequence[Sequence[int]]:
        """Of each episode one question."""
        return (self._few,)

    def select(self, answered: Sequence[MistakeAnswers], wanted: Sequence[int], turn: int) -> list[int]:
        """Return the places of those that fit better on a few questions."""
        del turn
        shares = []
        for place, one in enumerate(answered):
            found = self.margin(one, wanted)
            if found is not None:
                self.first_round.append((one.words, one.convention, found.share))
                shares.append((found.share, place))
        self.count += len(answered)
        return sorted(place for share, place in sorted(shares)[:_MOST] if share <= _PROMISING)

    def margin(self, answered: MistakeAnswers, wanted: Sequence[int]) -> Margin | None:
        """Return how answers fit beside what is declared, None where too little is known."""
        if answered.answers is None:
            return None
        own = self._own.get(tuple(wanted))
        declared = self._declared(tuple(wanted)) if own is None else own
        changed = self._ruler.errors(answered.answers, wanted)
        return margin(declared, changed, [self._ruler.session.question_steps[number][0] for number in wanted])

    def hardly_moves(self, given: Chunks) -> bool:
        """Tell whether answers lead arms less far than it would take to say anything."""
        return self._ruler.motion_share(given, self.everything) < _HARDLY

    @cache  # noqa: B019 - lives as long as one search
    def _declared(self, wanted: tuple[int, ...]) -> ActionErrors:
        return self._ruler.errors({number: self._given[number] for number in wanted}, wanted, self._refused)
