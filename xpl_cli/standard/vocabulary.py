"""Vocabularies of keys: allowed values, with definition, formula and source from the schema."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.standard.spec import Schema


@dataclass(frozen=True)
class VocabularyValue:
    """One value of a vocabulary.

    Attributes:
        name: the value as written.
        meaning: its definition.
        formula, source: those of the schema, or "".
        known_as: its names in other libraries, "library: name" each.
    """

    name: str
    meaning: str
    formula: str
    source: str
    known_as: str

    @property
    def description(self) -> str:
        """Return definition, formula, source and other names as one text."""
        parts = (
            self.meaning,
            self.formula and f"`{self.formula}`",
            self.source and f"Source: {self.source}",
            self.known_as and f"Known as {self.known_as}",
        )
        return ". ".join(part.rstrip(".") for part in parts if part) + "."


@dataclass(frozen=True)
class KeyVocabulary:
    """A key and its vocabulary."""

    key: str
    meaning: str
    values: tuple[VocabularyValue, ...]


def vocabularies(schema: Schema) -> list[KeyVocabulary]:
    """Return the vocabularies of a schema with defined values; equal ones once, in the schema's order."""
    vocabularies_by_key: dict[tuple[str, tuple[VocabularyValue, ...]], KeyVocabulary] = {}
    for name, entry in (("", schema), *schema.get("$defs", {}).items()):
        for vocabulary in _collect(entry, name):
            vocabularies_by_key.setdefault((vocabulary.key.rpartition(".")[2], vocabulary.values), vocabulary)
    return list(vocabularies_by_key.values())


def vocabulary_values(entry: Schema, definitions: Schema) -> tuple[VocabularyValue, ...]:
    """Return the defined values of a schema entry, or of the definition that it refers to."""
    if "$ref" in entry:
        return vocabulary_values(definitions.get(entry["$ref"].rpartition("/")[2], {}), definitions)
    values = tuple(value for option in entry.get("anyOf", ()) for value in vocabulary_values(option, definitions))
    return values or tuple(_value(one) for one in entry.get("oneOf", ()) if "const" in one and "description" in one)


def _collect(entry: Schema, path: str) -> Iterator[KeyVocabulary]:
    options = [option for option in entry.get("oneOf", ()) if "const" in option]
    if options and all("description" in option for option in options):
        yield KeyVocabulary(path, entry.get("description", ""), tuple(map(_value, options)))
    for option in entry.get("anyOf", ()):
        yield from _collect(option, path)
    for key, inner in entry.get("properties", {}).items():
        yield from _collect(inner, f"{path}.{key}".lstrip("."))
    if "items" in entry:
        yield from _collect(entry["items"], path)


def _value(option: Schema) -> VocabularyValue:
    other_names = "; ".join(f"{library}: {name}" for library, name in option.get("x-known-as", {}).items())
    formula, source = option.get("x-formula", ""), option.get("x-source", "")
    return VocabularyValue(str(option["const"]), option["description"], formula, source, other_names)
