"""JSON that others wrote, held against a schema before a value of it is used."""

from __future__ import annotations

import functools
import json
from typing import TYPE_CHECKING, Any, Final

from xpl import json_text
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Mapping

_MOST_TOLD: Final = 200


def parse_json(text: str | bytes, where: str) -> Any:
    """Return what a text of JSON holds.

    Raises:
        DataError: it is none that is taken (`json_text.parse`).
    """
    try:
        return json_text.parse(text)
    except json_text.JsonError as error:
        raise DataError(f"{where}: {error}") from None


def validate_value(value: Any, schema: str, where: str) -> Any:
    """Return a value that its schema takes.

    Args:
        value: as JSON has it.
        schema: JSON Schema, as text.
        where: of the value, for the error.

    Raises:
        DataError: the schema does not take it; with the first key that it does not.
    """
    try:
        fault = next(_validator(schema).iter_errors(value), None)
    except (ValueError, OverflowError, RecursionError, TypeError) as error:  # numbers beyond what JSON has elsewhere
        raise DataError(f"{where} holds what JSON does not: {str(error)[:_MOST_TOLD]}") from None
    if fault is not None:
        key = "/".join(str(part) for part in fault.instance_path)
        raise DataError(f"{where}{f': {key}' if key else ''}: {fault.message[:_MOST_TOLD]}")
    return value


def schema_text(schema: Mapping[str, Any]) -> str:
    """Return a schema as `checked` takes it."""
    return json.dumps(schema)


@functools.cache
def _validator(schema: str) -> Any:
    import jsonschema_rs

    return jsonschema_rs.validator_for(json_text.parse(schema))
