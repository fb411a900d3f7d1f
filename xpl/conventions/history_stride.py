"""Control steps between the observations of a history. Source: spec/v1/model_io.schema.json, `history.stride`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from xpl.catalogue import Case, Convention, Mistake, histories
from xpl.catalogue.edits import everywhere, word

if TYPE_CHECKING:
    from xpl.catalogue.mistake import Obs

_NAME = "history_stride"


def _in_block(case: Case) -> Iterator[Mistake]:
    sites = histories.sites(case.block)
    now = [site.entry.get("stride", 1) for site in sites]
    others = [(1, one + 1, max(1, one - 1), 2, 3, 4, 2 * one, max(1, one // 2)) for one in now]
    for value in dict.fromkeys(other for several in others for other in several):
        yield from everywhere(sites, 1, f"history: stride: {value}", _NAME, word("stride", value, 1))


def _around(case: Case) -> Iterator[Mistake]:
    if case.history < 2:
        return
    count = histories.span(case)
    for rank, stride in ((1, 2), (2, 3)):
        yield from histories.shown(rank, f"history: stride {stride}", _NAME, _strided(stride, count), case)
    yield from histories.shown(1, "history: stride 1, not 2", _NAME, _doubled, case)


def _strided(stride: int, count: int) -> histories.Order:
    return lambda seen: [*[seen[0]] * count, *seen[::-1][::stride][::-1]]


def _doubled(seen: Sequence[Obs]) -> list[Obs]:
    return [seen[0], *(obs for obs in seen[1:] for _ in range(2))]


CONVENTION = Convention(
    _NAME, in_block=_in_block, around=_around, keys={"history": ["stride"]}, applies=histories.are_there
)
