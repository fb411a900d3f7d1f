"""What mistakes of histories are written with: in the block, and in what is shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Callable

from xpl.catalogue import fields
from xpl.catalogue.edits import Block, Site
from xpl.catalogue.mistake import Case, Episode, Mistake, Obs, Shown

Order = Callable[[Sequence[Obs]], Sequence[Obs]]
"""Returns what a model is shown of the observations of an episode, oldest first."""


def sites(block: Block) -> list[Site]:
    """Return the histories of a block: the common one, and those of single inputs."""
    found = [Site(("history",), block["history"])] if block.get("history") else []
    for group in ("images", "state"):
        for at, entry in enumerate(block.get(group) or ()):
            if entry.get("history"):
                found.append(Site((group, at, "history"), entry["history"], group, entry["input"]))
    return found


def are_there(block: Block) -> bool:
    """Tell whether an input of a block shows more than the newest observation."""
    return any(isinstance(one.entry.get("length"), int) and one.entry["length"] != 1 for one in sites(block))


def shown(rank: int, words: str, convention: str, order: Order, case: Case) -> list[Mistake]:
    """Return the mistakes of an adapter that should see the observations as an order has them.

    Each question is played alone, because what is shown depends on it. Commands that were counted from the last state
    that was shown are counted from the true one, too.
    """

    def changed(observations: Sequence[Obs]) -> Episode:
        return [dict(obs) for obs in order(list(observations))]

    again: Shown = changed
    moved = [None, *fields.rebased(again, case.action_type)]
    return [Mistake(rank, words, convention, shown=again, commanded=one, windowed=True) for one in moved]


def span(case: Case) -> int:
    """Return how many control steps a model sees."""
    return (case.history - 1) * case.stride + 1


def last(seen: Sequence[Obs], count: int) -> list[Obs]:
    """Return as many observations as a model sees, the first one repeated."""
    kept = list(seen[-count:])
    return [kept[0]] * (count - len(kept)) + kept
