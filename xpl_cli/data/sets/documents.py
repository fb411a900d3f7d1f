"""Parsing and schema validation of third-party JSON."""

from __future__ import annotations

import functools
import json
from typing import TYPE_CHECKING, Any, Final

from xpl import json_text
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Mapping

_MOST_CHARACTERS: Final = 200


def parse_json(text: str | bytes, where: str) -> Any:
    """Parse JSON.

    Raises:
        DataError: the text is no JSON that `json_text.parse` accepts.
    """
    try:
        return json_text.parse(text)
    except json_text.JsonError as error:
        raise DataError(f"{where}: {error}") from None


def validate_value(value: Any, schema: str, where: str) -> Any:
    """Validate a JSON value against a schema and return it.

    Args:
        value: the value.
        schema: JSON Schema, as text.
        where: location of the value, for the error.

    Raises:
        DataError: the value violates the schema; the message has the first key that does.
    """
    try:
        fault = next(_validator(schema).iter_errors(value), None)
    except (ValueError, OverflowError, RecursionError, TypeError) as error:  # numbers that other JSON parsers reject
        raise DataError(f"{where} holds a value that JSON cannot represent: {str(error)[:_MOST_CHARACTERS]}") from None
    if fault is not None:
        key = "/".join(str(part) for part in fault.instance_path)
        raise DataError(f"{where}{f': {key}' if key else ''}: {fault.message[:_MOST_CHARACTERS]}")
    return value


def schema_text(schema: Mapping[str, Any]) -> str:
    """Return a schema in the form that `validate_value` takes."""
    return json.dumps(schema)


@functools.cache
def _validator(schema: str) -> Any:
    import jsonschema_rs

    return jsonschema_rs.validator_for(json_text.parse(schema))
