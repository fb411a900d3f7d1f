"""Control steps between the observations of a history. Source: spec/v1/model_io.schema.json, `history.stride`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from xpl.catalogue import AdapterCase, Convention, Mistake, histories
from xpl.catalogue.edits import mistakes_at_sites, set_key

if TYPE_CHECKING:
    from xpl.catalogue.mistake import Obs

_NAME = "history_stride"


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    sites = histories.sites(case.block)
    now = [site.entry.get("stride", 1) for site in sites]
    others = [(1, one + 1, max(1, one - 1), 2, 3, 4, 2 * one, max(1, one // 2)) for one in now]
    for value in dict.fromkeys(other for several in others for other in several):
        yield from mistakes_at_sites(sites, 1, f"history: stride: {value}", _NAME, set_key("stride", value, 1))


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if case.history < 2:
        return
    count = histories.span(case)
    for rank, stride in ((1, 2), (2, 3)):
        yield from histories.history_mistakes(
            rank, f"history: stride {stride}", _NAME, _set_stride(stride, count), case
        )
    yield from histories.history_mistakes(1, "history: stride 1, not 2", _NAME, _repeat_each, case)


def _set_stride(stride: int, count: int) -> histories.HistorySelection:
    return lambda observations: [*[observations[0]] * count, *observations[::-1][::stride][::-1]]


def _repeat_each(observations: Sequence[Obs]) -> list[Obs]:
    return [observations[0], *(obs for obs in observations[1:] for _ in range(2))]


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    keys={"history": ["stride"]},
    applies=histories.has_history,
)
