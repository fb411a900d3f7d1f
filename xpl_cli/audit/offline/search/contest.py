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
    from xpl_cli.audit.offline.search.loaded import Answered

Ask = Callable[[Sequence[int], Sequence[int]], Iterator["Answered"]]
"""Yields the answers under mistakes by their numbers, the first, to questions by theirs, the second, as far as the time
reaches."""


@dataclass(frozen=True)
class Family:
    """Mistakes whose answers are had in one way.

    Attributes:
        mistakes: the likeliest first.
        ask: yields answers under them.
        both: of pairs of mistakes by their numbers, the family in which both of each are undone; None where they cannot
            be undone together. It has the pairs that fit, `numbers`.
        numbers: of such a family, the pairs of its mistakes.
    """

    mistakes: Sequence[Mistake]
    ask: Ask
    both: Callable[[Sequence[tuple[int, int]]], Family | None] = lambda _pairs: None
    numbers: Sequence[tuple[int, int]] = ()


class Ruler(ABC):
    """Says how good the answers under a mistake are.

    Attributes:
        everything: the numbers of all questions.
    """

    everything: Sequence[int]

    @property
    @abstractmethod
    def rounds(self) -> Sequence[Sequence[int]]:
        """Questions on which mistakes are tried, round by round, before those that are left are tried on all."""

    @abstractmethod
    def kept(self, answered: Sequence[Answered], wanted: Sequence[int], turn: int) -> list[int]:
        """Return the places of those that are worth the next round, sorted.

        Args:
            answered: under each mistake.
            wanted: the questions.
            turn: number of the round.
        """


@dataclass(frozen=True)
class Held:
    """What became of a family.

    Attributes:
        first: what was answered in the first round, mistake by mistake.
        last: numbers of the mistakes that were tried on all questions, and what was answered.
    """

    first: Sequence[Answered]
    last: Sequence[tuple[int, Answered]]


def held(family: Family, ruler: Ruler) -> Held:
    """Try all mistakes of a family."""
    good: Sequence[int] = range(len(family.mistakes))
    first: list[Answered] = []
    for turn, wanted in enumerate(ruler.rounds):
        answered = list(family.ask(good, wanted)) if good else []
        first = answered if turn == 0 else first
        good = [good[place] for place in ruler.kept(answered, wanted, turn)]
    last = list(zip(good, family.ask(good, ruler.everything) if good else (), strict=False))
    return Held(first, last)
