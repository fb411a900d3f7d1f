"""Problems of a document: readable forms of a validator's errors."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from xpl.nested import format_path

_Error = Any
"""A `jsonschema.ValidationError`; its own annotations call every attribute possibly unset."""


@dataclass(frozen=True)
class Problem:
    """One difference between a document and its schema.

    Attributes:
        path: keys and positions that lead to the value, from the outside in.
        message: one sentence.
        expected: a valid value.
        got: the actual value.
        nearest: the valid name with the nearest spelling.
        file: the document's file, if it came from one.
        line, column: position in that file, from 1.
        page: page of the documentation that explains it.
        missing: the key that is missing, if that is the problem.
    """

    path: tuple[str | int, ...]
    message: str
    expected: str | None = None
    got: str | None = None
    nearest: str | None = None
    file: str | None = None
    line: int | None = None
    column: int | None = None
    page: str | None = None
    missing: str | None = None

    @property
    def location(self) -> str:
        """Its location: file, line and column as far as known, then the path."""
        position = [str(part) for part in (self.file, self.line, self.column) if part is not None]
        return " ".join(filter(None, [":".join(position), format_path(self.path)]))

    @property
    def text(self) -> str:
        """The message, with a suggestion."""
        return f"{self.message} (did you mean {self.nearest}?)" if self.nearest else self.message

    def __str__(self) -> str:
        return f"{self.location}: {self.text}" if self.location else self.text


def problem_json(problem: Problem) -> dict[str, Any]:
    """Return a problem as JSON, with its key as text."""
    return {**asdict(problem), "path": [str(part) for part in problem.path], "key": format_path(problem.path)}


def explain(error: _Error) -> Iterator[Problem]:
    """Yield readable problems for one error of the validator."""
    describe = _DESCRIPTIONS.get(str(error.validator))
    if describe is None:
        yield Problem(_path(error), error.message, got=describe_value(error.instance))
    else:
        yield from describe(error)


def _additional(error: _Error) -> Iterator[Problem]:
    keys = list(error.schema.get("properties", ()))
    for key in error.instance:
        if key not in keys:
            renamed = error.schema.get("x-renamed", {}).get(key)
            near = renamed or nearest(key, [name for name in keys if name not in error.instance] or keys)
            names = "" if near else f": expected {', '.join(keys)}"
            yield Problem(
                (*_path(error), str(key)),
                f"unknown key {key!r}{names}",
                expected=", ".join(keys),
                got=str(key),
                nearest=near,
            )


def _required(error: _Error) -> Iterator[Problem]:
    # One error per missing key, which the message alone names.
    key = next(name for name in error.validator_value if error.message.startswith(repr(name)))
    entry = error.schema.get("properties", {}).get(key, {})
    meaning = f" ({entry['description']})" if isinstance(entry, Mapping) and "description" in entry else ""
    present = ", ".join(map(str, error.instance)) or "nothing"
    unknown = [str(name) for name in error.instance if name not in error.schema.get("properties", ())]
    similar = difflib.get_close_matches(key, unknown, n=1)
    hint = f"; {similar[0]!r} may be meant for it" if similar else ""
    yield Problem(_path(error), f"the key {key!r}{meaning} is missing{hint}", expected=key, got=present, missing=key)


def _choice(error: _Error) -> Iterator[Problem]:
    allowed = error.validator_value if error.validator == "enum" else [error.validator_value]
    words = ", ".join(_value(item) for item in allowed)
    near = nearest(error.instance, [item for item in allowed if isinstance(item, str)])
    text = f"one of {words}" if len(allowed) > 1 else words
    yield Problem(
        _path(error), f"expected {text}, got {_value(error.instance)}", text, _value(error.instance), nearest=near
    )


def _type(error: _Error) -> Iterator[Problem]:
    types = error.validator_value
    types_expected: list[str] = types if isinstance(types, list) else [types]
    text = error.schema.get("x-told") or " or ".join(_TYPE_NAMES.get(name, name) for name in types_expected)
    got = describe_value(error.instance)
    meant = next(filter(None, (_meant(name, error.instance) for name in types_expected)), None)
    yield Problem(_path(error), f"expected {text}, got {got}", expected=text, got=got, nearest=meant)


def _meant(types_expected: str, given: object) -> str | None:
    """Return the YAML spelling of a value that was parsed as another type: yes, 3, 1e-2, "false"."""
    if types_expected == "string" and isinstance(given, (bool, int, float)):
        return f'"{_value(given)}"'
    if not isinstance(given, str):
        return None
    if types_expected == "boolean" and given.lower() in {"true", "false"}:
        return given.lower()
    try:
        number = float(given)
    except ValueError:
        return None
    if types_expected == "integer" and number.is_integer():
        return str(int(number))
    return repr(number) if types_expected == "number" and math.isfinite(number) else None


def _limit(error: _Error) -> Iterator[Problem]:
    text = _LIMITS[str(error.validator)].format(error.validator_value)
    yield Problem(_path(error), f"expected {text}, got {_value(error.instance)}", text, _value(error.instance))


def _array(error: _Error) -> Iterator[Problem]:
    expected, got = error.message.removeprefix("expected ").rsplit(", got ", 1)
    yield Problem(_path(error), error.message, expected=expected, got=got)


def _branches(error: _Error) -> Iterator[Problem]:
    """Report the nearest alternative; if none stands out, what the alternatives expect."""
    branches: dict[Any, list[_Error]] = {}
    for sub in error.context or ():
        branches.setdefault(sub.schema_path[0], []).append(sub)
    if not branches:  # oneOf: more than one fits
        yield Problem(_path(error), f"more than one alternative fits {describe_value(error.instance)}")
        return
    ranked = sorted(branches.values(), key=lambda errors: sum(map(_distance, errors)))
    best = [problem for sub in ranked[0] for problem in explain(sub)]
    if len(ranked) == 1 or any(problem.path != _path(error) for problem in best) or _is_map(error.instance):
        yield from best
        return
    options = dict.fromkeys(
        problem.expected for errors in ranked for sub in errors for problem in explain(sub) if problem.expected
    )
    got = best[0].got or describe_value(error.instance)
    yield Problem(
        _path(error), f"expected {' or '.join(options)}, got {got}", " or ".join(options), got, nearest=best[0].nearest
    )


def _distance(error: _Error) -> float:
    """Return the distance of a document from an alternative by one error: missing and extra keys count most."""
    if error.validator == "additionalProperties":
        names = error.schema.get("properties", ())
        return float(sum(key not in names for key in error.instance))
    if error.validator == "required":
        return 1.0
    if not error.path and (error.validator == "type" or (error.validator == "const" and _is_map(error.instance))):
        return 100.0  # another type
    if error.context:
        return min(_distance(sub) for sub in error.context)
    return 0.1


def nearest(given: Any, names: Any) -> str | None:
    """Return the most similar name, or None."""
    matches = difflib.get_close_matches(str(given), list(names), n=1, cutoff=0.6)
    return matches[0] if matches else None


def _path(error: _Error) -> tuple[str | int, ...]:
    return tuple(error.absolute_path)


def _is_map(value: object) -> bool:
    return isinstance(value, Mapping)


def _value(value: object) -> str:
    text = "null" if value is None else str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def describe_value(value: object) -> str:
    """Describe a value by its type, and by its value if short."""
    import numpy as np

    if value is None:
        return "null"
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} {value.dtype}"
    if isinstance(value, Mapping):
        return f"a map with {', '.join(map(str, value)) or 'nothing in it'}"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}: {_value(list(value))}" if value else "an empty list"
    if isinstance(value, (bytes, bytearray)):
        return f"{len(value)} bytes"
    name = {bool: "flag", str: "text", int: "integer", float: "number"}.get(type(value), type(value).__name__)
    return f"the {name} {_value(value)}"


_TYPE_NAMES = {
    "object": "a map",
    "array": "a list",
    "string": "text",
    "boolean": "true or false",
    "integer": "an integer",
} | {"number": "a number"}
_LIMITS = {
    "minimum": "at least {}",
    "maximum": "at most {}",
    "exclusiveMinimum": "more than {}",
    "minItems": "a list of at least {}",
    "maxItems": "a list of at most {}",
    "maxLength": "text of at most {} characters",
    "exclusiveMaximum": "less than {}",
    "minLength": "text of at least {} characters",
    "minProperties": "a map with at least {} keys",
    "pattern": "text that matches {}",
    "uniqueItems": "no entry twice",
}
_DESCRIPTIONS: dict[str, Callable[[_Error], Iterator[Problem]]] = {
    "additionalProperties": _additional,
    "required": _required,
    "enum": _choice,
    "const": _choice,
    "type": _type,
    "x-array": _array,
    "anyOf": _branches,
    "oneOf": _branches,
    **dict.fromkeys(_LIMITS, _limit),
}
