"""What stands for observations before the first. Source: spec/v1/model_io.schema.json, `history.pad` and `mask`."""

from __future__ import annotations

from collections.abc import Iterator

from xpl.catalogue import AdapterCase, Convention, Mistake, histories
from xpl.catalogue.edits import mistakes_at_sites, set_key

_NAME = "history_padding"


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for pad in ("zeros", "repeat"):
        change = set_key("pad", pad, "repeat")
        yield from mistakes_at_sites(histories.sites(case.block), 0, f"history: pad: {pad}", _NAME, change)


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if case.history < 2:
        return
    between = histories.span(case) - 2
    words = "history: the first observation instead of those before"
    yield from histories.history_mistakes(2, words, _NAME, lambda obs: [obs[0], *[obs[0]] * between, obs[-1]], case)


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    keys={"history": ["pad", "mask"]},
    applies=histories.has_history,
)
