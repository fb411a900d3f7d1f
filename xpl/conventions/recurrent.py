"""State that the model keeps, and when it advances. Source: spec/v1/model_io.schema.json, `recurrent`."""

from __future__ import annotations

from collections.abc import Iterator

from xpl.catalogue import Case, Convention, Mistake

_NAME = "recurrent"


def _in_inputs(_case: Case) -> Iterator[Mistake]:
    yield Mistake(0, "state: advanced once by each observation, not twice", _NAME, encoded={"kind": "once"})


CONVENTION = Convention(
    _NAME,
    in_inputs=_in_inputs,
    keys={"block": [_NAME]},
    applies=lambda block: bool(block.get(_NAME)),
)
