"""Answers as JSON: classes whose fields are the keys of a schema, in its order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, ClassVar


class JsonDocument:
    """An answer that a schema describes.

    Attributes:
        schema: its title.
    """

    schema: ClassVar[str]

    def as_json(self) -> dict[str, Any]:
        """Return the answer as JSON has it."""
        return {"schema": self.schema, **to_plain(self)}


def to_plain(value: object) -> Any:
    """Return a value as JSON has it: of dataclasses maps, of tuples lists."""
    if is_dataclass(value):
        return {item.name: to_plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {key: to_plain(entry) for key, entry in value.items()}
    return [to_plain(entry) for entry in value] if isinstance(value, (list, tuple)) else value
