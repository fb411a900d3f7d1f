"""Earlier observations: how many an input shows. Source: spec/v1/model_io.schema.json, `history.length` and `of`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from xpl.catalogue import AdapterCase, Convention, Mistake, histories
from xpl.catalogue.edits import mistakes_at_sites, set_key

if TYPE_CHECKING:
    from xpl.catalogue.mistake import ActionChange, ArrayMap, Obs, OptionalStep

_NAME = "history_length"


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    sites = histories.sites(case.block)
    for of in (["images", "state"], ["images"], ["state"]):
        change = set_key("of", of, ["images", "state"])
        yield from mistakes_at_sites(sites[:1], 2, f"history: of: {', '.join(of)}", _NAME, change)
    for value in dict.fromkeys(
        other for site in sites for other in (1, site.entry["length"] - 1, site.entry["length"] + 1, 2)
    ):
        if value >= 1:
            yield from mistakes_at_sites(sites, 3, f"history: length: {value}", _NAME, set_key("length", value))


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    yield Mistake(1, "answers: to the observation before", _NAME, change_actions=_shift_answers(1))
    yield Mistake(1, "answers: to the observation after", _NAME, change_actions=_shift_answers(-1))
    if case.history > 1:
        yield from histories.history_mistakes(
            0,
            "history: the newest shown once more",
            _NAME,
            lambda observations: [*observations, observations[-1]],
            case,
        )
        yield from histories.history_mistakes(
            1, "history: the newest only", _NAME, lambda observations: observations[-1:], case
        )


def _shift_answers(later: int) -> ActionChange:
    """Take the answer of another question of the episode; where there is none, it is not known."""

    def change_actions(
        answers: Sequence[Sequence[ArrayMap]], _observations: Sequence[Obs], _indices: Sequence[int]
    ) -> list[list[OptionalStep]]:
        result: list[list[OptionalStep]] = []
        for index, steps in enumerate(answers):
            other = index - later
            result.append(list(answers[other]) if 0 <= other < len(answers) else [None] * len(steps))
        return result

    return change_actions


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    keys={"history": ["length", "of"], "images": ["history"], "vectors": ["history"], "block": ["history"]},
    applies=histories.has_history,
)
