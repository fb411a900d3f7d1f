"""Parse and validate one line of a record: text, JSON, finite numbers, and the schema.

Runs have ten thousand lines and more: every line passes a compiled validator, and only lines that it rejects pass the
slower one with the better messages.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from xpl import json_text
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

KINDS: Final = ("run", "machine", "episode")
MOST_BYTES: Final = 4 << 20
"""Limit of a line; one with a layout of a thousand objects has 100 kB."""

Line = Mapping[str, Any]
"""A line of a record, as the schema has it."""
_SCHEMA: Final = "record"
_EACH: Final = "*"
_LONGEST: Final = 300


class LineError(ValueError):
    """An invalid line of a record; the message says why in one sentence."""


class LineNotJsonError(LineError):
    """Bytes that are no JSON at all: what may be left of a line that a crash cut short."""


def parse_line(raw: bytes) -> Line:
    """Return a line, as the schema has it.

    Args:
        raw: its bytes, without the end of the line.

    Raises:
        InvalidJsonError: it is no JSON.
        LineError: it is no line of a record.
    """
    if len(raw) > MOST_BYTES:
        raise LineError(f"it has {len(raw)} bytes, more than the {MOST_BYTES} that a line may have")
    try:
        line: Any = json_text.parse(raw, finite=True)
    except json_text.InvalidJsonError:
        raise LineNotJsonError("it is not JSON") from None
    except json_text.JsonError as error:
        raise LineError(str(error)) from None
    kind = line.get("kind") if isinstance(line, dict) else None
    if not isinstance(kind, str) or kind not in KINDS:
        raise LineError(f"expected a map whose kind is one of {', '.join(KINDS)}, got {_shorten(kind or line)}")
    if not _validator(kind)(line) or not all(_are_integers(line, path) for path in _integers(kind)):
        raise LineError(_reason(line, kind))
    parsed: Line = line
    return parsed


def definition(kind: str) -> str:
    """Return the schema of a kind of line, as `standard.validate` takes it."""
    return f"{_SCHEMA}#/$defs/{kind}"


@cache
def _validator(kind: str) -> Callable[[object], bool]:
    """Return a function that validates a line of this kind."""
    import jsonschema_rs

    schemas = [spec.schema(name) for name in spec.schema_names()]
    registry = jsonschema_rs.Registry([(schema["$id"], schema) for schema in schemas])
    reference = {"$ref": f"{spec.schema(_SCHEMA)['$id']}#/$defs/{kind}"}
    is_valid: Callable[[object], bool] = jsonschema_rs.Draft202012Validator(
        reference, registry=registry, validate_formats=True
    ).is_valid
    return is_valid


@cache
def _integers(kind: str) -> tuple[tuple[str, ...], ...]:
    """Return where the schema has integers in a line of a kind: to JSON Schema 2.0 is one, to Python it is not."""
    return tuple(_integer_paths(spec.schema(_SCHEMA)["$defs"][kind], ()))


def _integer_paths(schema: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    reference = schema.get("$ref", "")
    if reference.startswith("#/$defs/"):
        schema = spec.schema(_SCHEMA)["$defs"][reference.removeprefix("#/$defs/")]
    kinds = schema.get("type", ())
    if "integer" in ([kinds] if isinstance(kinds, str) else kinds):
        yield path
    for name, inner in schema.get("properties", {}).items():
        yield from _integer_paths(inner, (*path, name))
    for key in ("items", "additionalProperties"):
        if isinstance(inner := schema.get(key), dict):
            yield from _integer_paths(inner, (*path, _EACH))


def _are_integers(value: Any, path: tuple[str, ...]) -> bool:
    """Return whether the values at a path of a valid line are integers; optional ones may be missing."""
    for position, name in enumerate(path):
        if name == _EACH:
            inner = value.values() if isinstance(value, dict) else value
            rest = path[position + 1 :]
            if not rest:
                return not any(type(entry) is float for entry in inner)
            return all(_are_integers(entry, rest) for entry in inner)
        value = value.get(name)
        if value is None:
            return True
    return type(value) is not float


def _reason(line: Line, kind: str) -> str:
    """Return why a line is invalid."""
    from xpl_cli.standard.validate import validate

    problems = validate(line, definition(kind))
    message = str(problems[0]) if problems else "a time is not written as 2026-01-31T12:00:00Z"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{message if len(message) <= _LONGEST else f'{message[:_LONGEST]} ...'}{more}"


def _shorten(value: object) -> str:
    try:
        text = json.dumps(value)
    except (TypeError, ValueError, RecursionError):
        text = type(value).__name__
    return text if len(text) <= 60 else f"{text[:60]} ..."
