"""Classes whose objects are filled from a map: a field says what it takes, and what it has where that is not there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, fields
from typing import Any, Callable, TypeVar

_READER = "reader"
_DocumentT = TypeVar("_DocumentT", bound="Document")


class Document:
    """What is filled from a map as YAML or JSON has it."""

    @classmethod
    def parse(cls: type[_DocumentT], data: object) -> _DocumentT:  # noqa: PYI019 - Python 3.9 has no Self
        """Return the object that a map describes; anything else than a map counts as an empty one."""
        known: Mapping[Any, Any] = data if isinstance(data, Mapping) else {}
        declared = fields(cls)  # type: ignore[arg-type]
        found = {item.name: item.metadata[_READER](known.get(item.name)) for item in declared if item.metadata}
        values = {name: value for name, value in found.items() if value is not None}
        if any(item.name == "data" for item in declared):
            values["data"] = known
        return cls(**values)


def one(kind: type, default: object = None) -> Any:
    """Declare a value of one type; true and false are no numbers, and a whole number may stand for a float."""
    return field(default=default, metadata={_READER: _reader(kind)})


def many(kind: type, default: tuple[Any, ...] = ()) -> Any:
    """Declare a list, as a tuple of what has the type."""
    read = _reader(kind)

    def reader(value: object) -> tuple[Any, ...] | None:
        if not isinstance(value, Sequence) or isinstance(value, (str, bytes)):
            return None
        return tuple(made for item in value if (made := read(item)) is not None)

    return field(default=default, metadata={_READER: reader})


def named(kind: type) -> Any:
    """Declare a map from names to what has the type."""
    read = _reader(kind)

    def reader(value: object) -> dict[str, Any] | None:
        if not isinstance(value, Mapping):
            return None
        return {str(name): made for name, item in value.items() if (made := read(item)) is not None}

    return field(default_factory=dict, metadata={_READER: reader})


def part(kind: type) -> Any:
    """Declare a part that has its own defaults where the map does not have it."""
    return field(default_factory=kind, metadata={_READER: _reader(kind)})


def _reader(kind: type) -> Callable[[object], Any]:
    if issubclass(kind, Document):
        return lambda value: kind.parse(value) if isinstance(value, Mapping) else None
    if kind is float:
        return lambda value: value if isinstance(value, (int, float)) and not isinstance(value, bool) else None
    if kind is int:
        return lambda value: value if isinstance(value, int) and not isinstance(value, bool) else None
    return lambda value: value if isinstance(value, kind) else None
