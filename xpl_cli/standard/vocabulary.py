"""Words of a vocabulary: what a value may be called, with the definition, formula and source that the schema gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.standard.spec import Schema


@dataclass(frozen=True)
class VocabularyValue:
    """One word.

    Attributes:
        name: as it is written.
        meaning: its definition.
        formula, source: as the schema has them; "" where it has none.
        known_as: what others call it, "library: name" each.
    """

    name: str
    meaning: str
    formula: str
    source: str
    known_as: str

    @property
    def description(self) -> str:
        """Return all of it as one text, behind the name."""
        parts = (
            self.meaning,
            self.formula and f"`{self.formula}`",
            self.source and f"Source: {self.source}",
            self.known_as and f"Known as {self.known_as}",
        )
        return ". ".join(part.rstrip(".") for part in parts if part) + "."


@dataclass(frozen=True)
class KeyVocabulary:
    """A key whose value is one of some words."""

    key: str
    meaning: str
    values: tuple[VocabularyValue, ...]


def vocabularies(schema: Schema) -> list[KeyVocabulary]:
    """Return every choice of a schema of which a word has a definition; equal ones once, in the schema's order."""
    found: dict[tuple[str, tuple[VocabularyValue, ...]], KeyVocabulary] = {}
    for name, entry in (("", schema), *schema.get("$defs", {}).items()):
        for choice in _choices(entry, name):
            found.setdefault((choice.key.rpartition(".")[2], choice.values), choice)
    return list(found.values())


def vocabulary_values(entry: Schema, definitions: Schema) -> tuple[VocabularyValue, ...]:
    """Return the words that an entry of a schema, or the definition that it refers to, has a definition of."""
    if "$ref" in entry:
        return vocabulary_values(definitions.get(entry["$ref"].rpartition("/")[2], {}), definitions)
    found = tuple(word for option in entry.get("anyOf", ()) for word in vocabulary_values(option, definitions))
    return found or tuple(_word(one) for one in entry.get("oneOf", ()) if "const" in one and "description" in one)


def _choices(entry: Schema, place: str) -> Iterator[KeyVocabulary]:
    options = [option for option in entry.get("oneOf", ()) if "const" in option]
    if options and all("description" in option for option in options):
        yield KeyVocabulary(place, entry.get("description", ""), tuple(map(_word, options)))
    for option in entry.get("anyOf", ()):
        yield from _choices(option, place)
    for key, inner in entry.get("properties", {}).items():
        yield from _choices(inner, f"{place}.{key}".lstrip("."))
    if "items" in entry:
        yield from _choices(entry["items"], place)


def _word(option: Schema) -> VocabularyValue:
    known = "; ".join(f"{library}: {name}" for library, name in option.get("x-known-as", {}).items())
    formula, source = option.get("x-formula", ""), option.get("x-source", "")
    return VocabularyValue(str(option["const"]), option["description"], formula, source, known)
