"""Earlier observations: how many, which, in which order, what stands for missing ones.

Source: spec/v1/model_io.schema.json, `history`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Callable

from xpl.catalogue import Case, Convention, Mistake, fields
from xpl.catalogue.edits import Site, everywhere, word
from xpl.catalogue.mistake import Commanded, Episode, Given, Obs, Shown, Step

_NAME = "history"

_Order = Callable[[Sequence[Obs]], Sequence[Obs]]


def _in_block(case: Case) -> Iterator[Mistake]:
    history = case.block.get("history")
    if not history:
        return
    site = [Site(("history",), history)]
    length, stride = history["length"], history.get("stride", 1)
    for pad in ("zeros", "repeat"):
        yield from everywhere(site, 0, f"history: pad: {pad}", _NAME, word("pad", pad, "repeat"))
    for value in dict.fromkeys((1, stride + 1, max(1, stride - 1), 2, 3, 4, 2 * stride, max(1, stride // 2))):
        yield from everywhere(site, 1, f"history: stride: {value}", _NAME, word("stride", value, 1))
    for of in (["images", "state"], ["images"], ["state"]):
        change = word("of", of, ["images", "state"])
        yield from everywhere(site, 2, f"history: of: {', '.join(of)}", _NAME, change)
    for value in dict.fromkeys((1, length - 1, length + 1, 2)):
        if value >= 1:
            yield from everywhere(site, 3, f"history: length: {value}", _NAME, word("length", value))


def _around(case: Case) -> Iterator[Mistake]:
    """Yield changes of the order and the distance of the observations that a model sees.

    Each question is played alone, because what is shown depends on it.
    """
    yield Mistake(1, "answers: to the observation before", _NAME, commanded=_of_question(1))
    yield Mistake(1, "answers: to the observation after", _NAME, commanded=_of_question(-1))
    if case.history < 2:
        return
    span = (case.history - 1) * case.stride + 1
    for rank, words, order in (
        (0, "history: the other order in time", lambda seen: _last(seen, span)[::-1]),
        (0, "history: the newest shown once more", lambda seen: [*seen, seen[-1]]),
        (1, "history: the newest only", lambda seen: seen[-1:]),
        (1, "history: stride 2", lambda seen: [*[seen[0]] * span, *seen[::-1][::2][::-1]]),
        (2, "history: stride 3", lambda seen: [*[seen[0]] * span, *seen[::-1][::3][::-1]]),
        (1, "history: stride 1, not 2", _doubled),
        (
            2,
            "history: the first observation instead of those before",
            lambda seen: [seen[0], *[seen[0]] * (span - 2), seen[-1]],
        ),
        (2, "history: the oldest and the newest exchanged", lambda seen: _ends(_last(seen, span))),
    ):
        shown = _shown(order)
        yield Mistake(rank, words, _NAME, shown=shown, windowed=True)
        for moved in fields.rebased(shown, case.action_type):
            yield Mistake(rank, words, _NAME, shown=shown, commanded=moved, windowed=True)


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


def _of_question(later: int) -> Commanded:
    """Take the answer of another question of the episode; where there is none, it is not known."""

    def commanded(answers: Sequence[Sequence[Given]], _seen: Sequence[Obs], _asked: Sequence[int]) -> list[list[Step]]:
        result: list[list[Step]] = []
        for index, steps in enumerate(answers):
            other = index - later
            result.append(list(answers[other]) if 0 <= other < len(answers) else [None] * len(steps))
        return result

    return commanded


CONVENTION = Convention(_NAME, in_block=_in_block, around=_around)
