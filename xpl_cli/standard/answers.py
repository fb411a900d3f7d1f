"""The JSON answers of all commands, with their schemas in `answers.yml`.

An answer is an object: `schema` has its name and version, and `next` lists exact next commands. Within a version, keys
are only added.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.basics.errors import UnknownTargetError, no_such
from xpl_cli.basics.yaml import text as yaml_text

if TYPE_CHECKING:
    from collections.abc import Mapping

_LIST: Final = Path(__file__).with_name("answers.yml")
_STANDARD: Final = "standard"
_NEXT: Final = {"type": "array", "items": {"type": "string"}, "description": "exact commands that are worth running"}


@dataclass(frozen=True)
class CommandAnswer:
    """One kind of answer.

    Attributes:
        name: the value of its `schema`.
        commands: commands that print it, such as `xpl spec show`; empty for answers of any command.
        description: its content, one sentence.
    """

    name: str
    commands: tuple[str, ...]
    description: str


@cache
def answers() -> dict[str, CommandAnswer]:
    """Return all answers by name."""
    return {
        name: CommandAnswer(name, tuple(entry["commands"]), entry["description"]) for name, entry in _entries().items()
    }


def of_command(command: str) -> tuple[str, ...]:
    """Return the names of the answers of a command, such as `xpl spec show`."""
    return tuple(name for name, answer in answers().items() if command in answer.commands)


def find(name: str) -> CommandAnswer:
    """Return an answer by its name or its command, with or without `xpl`.

    Raises:
        UnknownNameError: if there is none.
    """
    by_command = {command: answer for answer in answers().values() for command in reversed(answer.commands)}
    for by_name in (answers(), by_command):
        for candidate in (name, f"xpl {name}"):
            if candidate in by_name:
                return by_name[candidate]
    raise no_such(f"no command answers {name!r}", name, answers(), listing="xpl answers", kind=UnknownTargetError)


def schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of an answer, which refers to the standard's schemas only."""
    entry = _entries()[name]
    if _STANDARD in entry:
        from xpl_cli.standard import spec

        return spec.schema(entry[_STANDARD])
    properties = {"schema": {"const": name}, **entry["properties"], "next": _NEXT}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": name,
        "description": entry["description"],
        **_closed({**entry, "properties": properties}),
    }


def problems(document: Mapping[str, Any]) -> list[str]:
    """Return the differences between a document and the schema that it names; none if it is valid.

    Raises:
        UnknownNameError: if there is no answer of that name.
    """
    name = find(str(document.get("schema"))).name
    if standard := _entries()[name].get(_STANDARD):
        from xpl_cli.standard.validate import validate

        return list(map(str, validate(document, standard)))
    from jsonschema import Draft202012Validator

    return [f"{error.json_path}: {error.message}" for error in Draft202012Validator(schema(name)).iter_errors(document)]


def _closed(entry: object) -> Any:
    """Expand a schema of the list: a map has exactly its listed keys, of which some are optional."""
    if isinstance(entry, list):
        return [_closed(item) for item in entry]
    if not isinstance(entry, dict):
        return entry
    if "properties" not in entry:
        return {key: _closed(value) for key, value in entry.items()}
    properties: Mapping[str, Any] = entry["properties"]
    optional = entry.get("optional", ())
    return {
        "type": entry.get("type", "object"),
        "properties": {key: _closed(value) for key, value in properties.items()},
        "required": [key for key in properties if key not in optional],
        "additionalProperties": False,
    }


@cache
def _entries() -> dict[str, Any]:
    parsed: dict[str, Any] = yaml_text.parse(_LIST.read_bytes())
    return {name: entry for name, entry in parsed.items() if not name.startswith("_")}
