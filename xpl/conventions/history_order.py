"""In which order an input shows observations. Source: spec/v1/model_io.schema.json, `history.order`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.catalogue import Case, Convention, Mistake, histories, walk
from xpl.catalogue.edits import everywhere, word

if TYPE_CHECKING:
    from xpl.catalogue.mistake import Obs

_NAME = "history_order"


def _in_block(case: Case) -> Iterator[Mistake]:
    for order in ("newest_first", "oldest_first"):
        change = word("order", order, "oldest_first")
        yield from everywhere(histories.sites(case.block), 0, f"history: order: {order}", _NAME, change)


def _around(case: Case) -> Iterator[Mistake]:
    if case.history < 2:
        return
    count = histories.span(case)
    words = "history: the other order in time"
    yield from histories.shown(0, words, _NAME, lambda seen: histories.last(seen, count)[::-1], case)
    words = "history: the oldest and the newest exchanged"
    yield from histories.shown(2, words, _NAME, lambda seen: _ends(histories.last(seen, count)), case)


def _ends(seen: Sequence[Obs]) -> list[Obs]:
    return [seen[-1], *seen[1:-1], seen[0]]


def _in_inputs(case: Case) -> Iterator[Mistake]:
    if case.history > 1:
        for rank, told, of in ((0, "", "all"), (1, " of the pictures", "pictures"), (1, " of the vectors", "vectors")):
            for way in ("in", "batch"):  # histories are made by the adapter's `encode`, or of what that made
                how = {"kind": "reversed", "length": case.history, "of": of, "way": way}
                yield Mistake(rank, f"history{told}: the other order in time", _NAME, encoded=how)


def _reversed(value: Any, how: Mapping[str, Any]) -> Any:
    """Return inputs whose history is reversed: an axis that is as long, before a picture or a vector, or a list.

    Of a batch, `xpl.Policy` hands a list for each environment to a model whose adapter has no block.

    Raises:
        UnfitError: if there is none.
    """
    if how.get("way") == "batch" and how["of"] == "all" and isinstance(value, list) and _are_lists(value):
        return [frames[::-1] for frames in value]
    seen = False

    def change(leaf: Any) -> Any:
        nonlocal seen
        if isinstance(leaf, str):
            return None
        is_picture = walk.channel_axis(leaf) is not None
        axis = leaf.ndim - (4 if is_picture else 2)
        wanted = how["of"] in {"all", "pictures" if is_picture else "vectors"}
        if axis < (how.get("way") == "batch") or leaf.shape[axis] != how["length"] or not wanted:
            return None
        seen = True
        return np.ascontiguousarray(np.flip(leaf, axis))

    result = walk.changed(value, change)
    if not seen:
        raise walk.UnfitError("no history of this length")
    return result


def _are_lists(value: Sequence[Any]) -> bool:
    """Tell whether a batch has a list of inputs for each environment, and some more than one."""
    return all(isinstance(frames, list) for frames in value) and any(len(frames) > 1 for frames in value)


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    around=_around,
    in_inputs=_in_inputs,
    kinds={"reversed": _reversed},
    keys={"history": ["order"]},
    applies=histories.are_there,
)
