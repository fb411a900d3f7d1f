"""Dataclasses that are parsed from a map: a field declares its type and its default."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, fields
from typing import Any, Callable, TypeVar

_READER = "reader"
_DocumentT = TypeVar("_DocumentT", bound="Document")


class Document:
    """Base of dataclasses that are parsed from a map of YAML or JSON."""

    @classmethod
    def parse(cls: type[_DocumentT], data: object) -> _DocumentT:  # noqa: PYI019 - Python 3.9 has no Self
        """Parse a map; anything else counts as an empty map."""
        entries: Mapping[Any, Any] = data if isinstance(data, Mapping) else {}
        declared = fields(cls)  # type: ignore[arg-type]
        parsed = {item.name: item.metadata[_READER](entries.get(item.name)) for item in declared if item.metadata}
        values = {name: value for name, value in parsed.items() if value is not None}
        if any(item.name == "data" for item in declared):
            values["data"] = entries
        return cls(**values)


def value_field(kind: type, default: object = None) -> Any:
    """Declare a value of one type; a bool is no number, an int is valid as float."""
    return field(default=default, metadata={_READER: _reader(kind)})


def list_field(kind: type, default: tuple[Any, ...] = ()) -> Any:
    """Declare a list, parsed to a tuple of the items of the type."""
    read = _reader(kind)

    def reader(value: object) -> tuple[Any, ...] | None:
        if not isinstance(value, Sequence) or isinstance(value, (str, bytes)):
            return None
        return tuple(made for item in value if (made := read(item)) is not None)

    return field(default=default, metadata={_READER: reader})


def map_field(kind: type) -> Any:
    """Declare a map from names to values of the type."""
    read = _reader(kind)

    def reader(value: object) -> dict[str, Any] | None:
        if not isinstance(value, Mapping):
            return None
        return {str(name): made for name, item in value.items() if (made := read(item)) is not None}

    return field(default_factory=dict, metadata={_READER: reader})


def nested_field(kind: type) -> Any:
    """Declare a nested object, which has its own defaults if the map lacks it."""
    return field(default_factory=kind, metadata={_READER: _reader(kind)})


def _reader(kind: type) -> Callable[[object], Any]:
    if issubclass(kind, Document):
        return lambda value: kind.parse(value) if isinstance(value, Mapping) else None
    if kind is float:
        return lambda value: value if isinstance(value, (int, float)) and not isinstance(value, bool) else None
    if kind is int:
        return lambda value: value if isinstance(value, int) and not isinstance(value, bool) else None
    return lambda value: value if isinstance(value, kind) else None
