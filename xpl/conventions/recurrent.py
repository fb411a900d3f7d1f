"""State that the model keeps, and when it advances. Source: spec/v1/model_io.schema.json, `recurrent`."""

from __future__ import annotations

from xpl.catalogue import Convention

CONVENTION = Convention("recurrent", keys={"block": ["recurrent"]}, applies=lambda block: bool(block.get("recurrent")))
