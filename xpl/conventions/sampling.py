"""What is drawn, and from which seed. Source: spec/v1/model_io.schema.json, `sampling`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl.catalogue import Case, Convention, Mistake

if TYPE_CHECKING:
    from collections.abc import Iterator

_NAME = "sampling"


def _in_inputs(_case: Case) -> Iterator[Mistake]:
    """Yield other draws; without any of them a model draws nothing, and nothing changes."""
    for rank, told, kind in (
        (0, "", "own"),
        (1, ", in double precision", "double"),
        (1, ", in single precision", "single"),
    ):
        words = f"drawn from each environment's generator{told}"
        yield Mistake(rank, words, _NAME, encoded={"kind": "drawn", "as": kind})


CONVENTION = Convention(
    _NAME,
    in_inputs=_in_inputs,
    keys={"block": [_NAME]},
    applies=lambda block: block.get(_NAME, "none") != "none",
)
