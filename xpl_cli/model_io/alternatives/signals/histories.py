"""Histories as models see them. Each question is played alone, because what is shown depends on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from xpl_cli.model_io.alternatives.signals.signal import Episode, Obs, Shown, Signal
from xpl_cli.model_io.alternatives.signals.ways import rebased

_Order = Callable[[Sequence[Obs]], Sequence[Obs]]


def histories(length: int, action_type: str, stride: int = 1) -> Iterator[Signal]:
    """Yield changes of the order and the distance of the observations that a model sees.

    Args:
        length: observations that the adapter keeps, the newest included.
        action_type: joint or ee.
        stride: control steps between them.
    """
    if length < 2:
        return
    span = (length - 1) * stride + 1
    for rank, words, convention, order in (
        (0, "history: the other order in time", "history_order", lambda seen: _last(seen, span)[::-1]),
        (0, "history: the newest shown once more", "history_length", lambda seen: [*seen, seen[-1]]),
        (1, "history: the newest only", "history_length", lambda seen: seen[-1:]),
        (1, "history: stride 2", "history_stride", lambda seen: [*[seen[0]] * span, *seen[::-1][::2][::-1]]),
        (2, "history: stride 3", "history_stride", lambda seen: [*[seen[0]] * span, *seen[::-1][::3][::-1]]),
        (1, "history: stride 1, not 2", "history_stride", _doubled),
        (
            2,
            "history: the first observation instead of those before",
            "history_padding",
            lambda seen: [seen[0], *[seen[0]] * (span - 2), seen[-1]],
        ),
        (2, "history: the oldest and the newest exchanged", "history_order", lambda seen: _ends(_last(seen, span))),
    ):
        shown = _shown(order)
        yield Signal(rank, words, convention, shown, windowed=True)
        for moved in rebased(shown, action_type):
            yield Signal(rank, words, convention, shown, moved, windowed=True)


def _shown(order: _Order) -> Shown:
    def shown(observations: Sequence[Obs]) -> Episode:
        return [dict(obs) for obs in order(list(observations))]

    return shown


def _last(seen: Sequence[Obs], span: int) -> list[Obs]:
    """Return as many observations as a model sees, the first one repeated."""
    kept = list(seen[-span:])
    return [kept[0]] * (span - len(kept)) + kept


def _doubled(seen: Sequence[Obs]) -> list[Obs]:
    return [seen[0], *(obs for obs in seen[1:] for _ in range(2))]


def _ends(seen: list[Obs]) -> list[Obs]:
    return [seen[-1], *seen[1:-1], seen[0]]
