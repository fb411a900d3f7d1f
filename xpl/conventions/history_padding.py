"""What stands for observations before the first. Source: spec/v1/model_io.schema.json, `history.pad` and `mask`."""

from __future__ import annotations

from collections.abc import Iterator

from xpl.catalogue import Case, Convention, Mistake, histories
from xpl.catalogue.edits import everywhere, word

_NAME = "history_padding"


def _in_block(case: Case) -> Iterator[Mistake]:
    for pad in ("zeros", "repeat"):
        change = word("pad", pad, "repeat")
        yield from everywhere(histories.sites(case.block), 0, f"history: pad: {pad}", _NAME, change)


def _around(case: Case) -> Iterator[Mistake]:
    if case.history < 2:
        return
    between = histories.span(case) - 2
    words = "history: the first observation instead of those before"
    yield from histories.shown(2, words, _NAME, lambda seen: [seen[0], *[seen[0]] * between, seen[-1]], case)


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    around=_around,
    keys={"history": ["pad", "mask"]},
    applies=histories.are_there,
)
