"""Earlier observations: how many an input shows. Source: spec/v1/model_io.schema.json, `history.length` and `of`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from xpl.catalogue import Case, Convention, Mistake, histories
from xpl.catalogue.edits import everywhere, word

if TYPE_CHECKING:
    from xpl.catalogue.mistake import Commanded, Given, Obs, Step

_NAME = "history_length"


def _in_block(case: Case) -> Iterator[Mistake]:
    sites = histories.sites(case.block)
    for of in (["images", "state"], ["images"], ["state"]):
        change = word("of", of, ["images", "state"])
        yield from everywhere(sites[:1], 2, f"history: of: {', '.join(of)}", _NAME, change)
    for value in dict.fromkeys(
        other for site in sites for other in (1, site.entry["length"] - 1, site.entry["length"] + 1, 2)
    ):
        if value >= 1:
            yield from everywhere(sites, 3, f"history: length: {value}", _NAME, word("length", value))


def _around(case: Case) -> Iterator[Mistake]:
    yield Mistake(1, "answers: to the observation before", _NAME, commanded=_of_question(1))
    yield Mistake(1, "answers: to the observation after", _NAME, commanded=_of_question(-1))
    if case.history > 1:
        yield from histories.shown(
            0, "history: the newest shown once more", _NAME, lambda seen: [*seen, seen[-1]], case
        )
        yield from histories.shown(1, "history: the newest only", _NAME, lambda seen: seen[-1:], case)


def _of_question(later: int) -> Commanded:
    """Take the answer of another question of the episode; where there is none, it is not known."""

    def commanded(answers: Sequence[Sequence[Given]], _seen: Sequence[Obs], _asked: Sequence[int]) -> list[list[Step]]:
        result: list[list[Step]] = []
        for index, steps in enumerate(answers):
            other = index - later
            result.append(list(answers[other]) if 0 <= other < len(answers) else [None] * len(steps))
        return result

    return commanded


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    around=_around,
    keys={"history": ["length", "of"], "images": ["history"], "vectors": ["history"], "block": ["history"]},
    applies=histories.are_there,
)
