"""In which order an input shows observations. Source: spec/v1/model_io.schema.json, `history.order`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.catalogue import AdapterCase, Convention, Mistake, histories, walk
from xpl.catalogue.edits import mistakes_at_sites, set_key

if TYPE_CHECKING:
    from xpl.catalogue.mistake import Obs

_NAME = "history_order"


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for order in ("newest_first", "oldest_first"):
        change = set_key("order", order, "oldest_first")
        yield from mistakes_at_sites(histories.sites(case.block), 0, f"history: order: {order}", _NAME, change)


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if case.history < 2:
        return
    count = histories.span(case)
    words = "history: the other order in time"
    yield from histories.history_mistakes(
        0, words, _NAME, lambda observations: histories.last_padded(observations, count)[::-1], case
    )
    words = "history: the oldest and the newest exchanged"
    yield from histories.history_mistakes(
        2, words, _NAME, lambda observations: _swap_ends(histories.last_padded(observations, count)), case
    )


def _swap_ends(observations: Sequence[Obs]) -> list[Obs]:
    return [observations[-1], *observations[1:-1], observations[0]]


def _input_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if case.history > 1:
        for rank, label, of in ((0, "", "all"), (1, " of the pictures", "pictures"), (1, " of the vectors", "vectors")):
            for way in ("in", "batch"):  # histories are made by the adapter's `encode`, or of what that made
                how = {"kind": "reversed", "length": case.history, "of": of, "way": way}
                yield Mistake(rank, f"history{label}: the other order in time", _NAME, input_change=how)


def _reverse_history(value: Any, how: Mapping[str, Any]) -> Any:
    """Return inputs whose history is reversed: an axis that is as long, before a picture or a vector, or a list.

    Of a batch, `xpl.Policy` hands a list for each environment to a model whose adapter has no block.

    Raises:
        NoEffectError: if there is none.
    """
    if how.get("way") == "batch" and how["of"] == "all" and isinstance(value, list) and _are_lists(value):
        return [frames[::-1] for frames in value]
    is_found = False

    def change(leaf: Any) -> Any:
        nonlocal is_found
        if isinstance(leaf, str):
            return None
        is_picture = walk.channel_axis(leaf) is not None
        axis = leaf.ndim - (4 if is_picture else 2)
        is_selected = how["of"] in {"all", "pictures" if is_picture else "vectors"}
        if axis < (how.get("way") == "batch") or leaf.shape[axis] != how["length"] or not is_selected:
            return None
        is_found = True
        return np.ascontiguousarray(np.flip(leaf, axis))

    result = walk.map_leaves(value, change)
    if not is_found:
        raise walk.NoEffectError("no history of this length")
    return result


def _are_lists(value: Sequence[Any]) -> bool:
    """Tell whether a batch has a list of inputs for each environment, and some more than one."""
    return all(isinstance(frames, list) for frames in value) and any(len(frames) > 1 for frames in value)


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    input_mistakes=_input_mistakes,
    input_changes={"reversed": _reverse_history},
    keys={"history": ["order"]},
    applies=histories.has_history,
)
