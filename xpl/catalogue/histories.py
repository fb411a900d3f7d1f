"""Mistakes of observation histories: in the block, and in the observations sent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Callable

from xpl.catalogue import fields
from xpl.catalogue.edits import Block, Site
from xpl.catalogue.mistake import AdapterCase, Mistake, Obs, ObservationChange, ObservationList

HistorySelection = Callable[[Sequence[Obs]], Sequence[Obs]]
"""Returns the observations that a model is sent, of those of an episode, oldest first."""


def sites(block: Block) -> list[Site]:
    """Return the histories of a block: the common one, and those of individual inputs."""
    sites = [Site(("history",), block["history"])] if block.get("history") else []
    for group in ("images", "state"):
        for at, entry in enumerate(block.get(group) or ()):
            if entry.get("history"):
                sites.append(Site((group, at, "history"), entry["history"], group, entry["input"]))
    return sites


def has_history(block: Block) -> bool:
    """Return whether an input of a block has more than the newest observation."""
    return any(isinstance(one.entry.get("length"), int) and one.entry["length"] != 1 for one in sites(block))


def history_mistakes(
    rank: int, words: str, convention: str, select: HistorySelection, case: AdapterCase
) -> list[Mistake]:
    """Return the mistakes of an adapter that should be sent the observations that `select` returns.

    Each call is run by itself, because the observations sent depend on it. Delta actions relative to the last state
    sent are also rebased to the true state.

    Args:
        rank: 0 for the likeliest.
        words: description of the mistake.
        convention: name of its convention.
        select: returns the observations to send, of those of the episode up to the call, oldest first.
        case: the adapter.
    """

    def changed(observations: Sequence[Obs]) -> ObservationList:
        return [dict(obs) for obs in select(list(observations))]

    again: ObservationChange = changed
    moved = [None, *fields.rebase_actions(again, case.action_type)]
    return [
        Mistake(rank, words, convention, change_observations=again, change_actions=one, windowed=True) for one in moved
    ]


def span(case: AdapterCase) -> int:
    """Return the number of control steps that a history spans."""
    return (case.history - 1) * case.stride + 1


def last_padded(observations: Sequence[Obs], count: int) -> list[Obs]:
    """Return the last `count` observations, padded by the first one."""
    window = list(observations[-count:])
    return [window[0]] * (count - len(window)) + window
