"""Validation against the schemas of the standard, with errors that say where, what was expected and what came.

The schemas are JSON Schema 2020-12 and one keyword of our own, `x-array: {shape, dtype}`, for arrays and nested lists.
A shape entry is a number or a symbol. DOF, EEF and T are bound once per document; H, W and N once per object that holds
the arrays, because the cameras of one robot may differ.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any, cast

import yaml

from xpl import variants
from xpl.assumptions import resolve_assumptions
from xpl_cli.basics.yaml import text
from xpl_cli.standard import spec, unknown
from xpl_cli.standard.problems import Problem, describe_value, explain

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from jsonschema.exceptions import ValidationError
    from jsonschema.protocols import Validator
    from referencing import Registry

    from xpl.contract import Entry
    from xpl_cli.standard.spec import Schema

__all__ = ["Problem", "mark_of", "page_of", "registry", "shape_text", "validate", "validate_yaml", "validate_yaml_file"]

_LOCAL_SYMBOLS = frozenset("HWN")
_OPEN = "policy"
"""The schema of documents in which `{unknown: why}` or `{assumed: value, why: reason}` may stand for a value."""
# Kinds of numpy dtypes: signed and unsigned integers, floats.
_KINDS = {"uint8": "u", "float": "f", "number": "iuf"}


def validate(instance: Any, schema_name: str, bindings: Mapping[str, int] | None = None) -> list[Problem]:
    """Return the problems of a document, sorted by path; none if it is valid.

    Args:
        instance: the document; arrays may be numpy arrays, nested lists, or bytes for 1-D uint8.
        schema_name: name of a schema, such as "observation"; a definition in it is "payload#/$defs/hello".
        bindings: known sizes of symbols, for example `{"DOF": 6}`.
    """
    gaps: dict[unknown.KeyPath, str] = {}
    if schema_name == _OPEN:
        instance, gaps = unknown.split(resolve_assumptions(instance))
    token = _scopes.set(_Scopes(document=dict(bindings or {})))
    try:
        errors = list(_validator(schema_name).iter_errors(instance))
    except RecursionError:
        return [Problem((), "the document contains itself, or is nested too deeply")]
    finally:
        _scopes.reset(token)
    problems = [_unknown(problem, gaps) for error in errors for problem in explain(error)]
    if schema_name == _OPEN and isinstance(instance, Mapping):
        problems += _of_variants(instance, problems)
    return sorted(dict.fromkeys(problems), key=lambda problem: [str(part) for part in problem.path])


@cache
def _validator(schema_name: str) -> Validator:
    """Return the compiled validator of a schema."""
    name, _, fragment = schema_name.partition("#")
    identifier = spec.schema(name)["$id"]
    schema = {"$ref": f"{identifier}#{fragment}" if fragment else identifier}
    return _validator_class()(schema, registry=registry())


@cache
def registry() -> Registry[Any]:
    """Return the registry of all schemas by `$id`."""
    from referencing import Registry
    from referencing.jsonschema import DRAFT202012

    resources = []
    for schema in map(spec.schema, spec.schema_names()):
        # With `$schema` in path the validator would change to the plain class of that dialect at every reference.
        contents = {key: value for key, value in schema.items() if key != "$schema"}
        resources.append((schema["$id"], DRAFT202012.create_resource(contents)))
    return Registry().with_resources(resources)


# -- the keyword x-array -----------------------------------------------------------------------------------------------


@dataclass
class _Scopes:
    """Sizes of symbols: of the whole document, and of each enclosing object, innermost last."""

    document: dict[str, int] = field(default_factory=dict)
    objects: list[dict[str, int]] = field(default_factory=list)

    def of(self, symbol: str) -> dict[str, int]:
        return self.objects[-1] if symbol in _LOCAL_SYMBOLS and self.objects else self.document


_scopes: ContextVar[_Scopes] = ContextVar("_scopes")


@cache
def _validator_class() -> Callable[..., Validator]:
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import ValidationError
    from jsonschema.validators import extend

    keywords = cast("dict[str, Callable[..., Any]]", Draft202012Validator.VALIDATORS)

    def x_array(_validator: object, expected: Schema, instance: object, _schema: object) -> Iterator[ValidationError]:
        if message := _array_message(expected, instance):
            yield ValidationError(message)

    def scoped(keyword: str) -> Callable[..., Any]:
        """Give each nested object its own symbols."""
        original = keywords[keyword]

        def check(validator: object, wanted: object, instance: object, schema: object) -> Iterator[ValidationError]:
            objects = _scopes.get().objects
            objects.append({})
            try:
                errors = list(original(validator, wanted, instance, schema))
            finally:
                objects.pop()
            yield from errors

        return check

    def words_only(keyword: str) -> Callable[..., Any]:
        """Convert arrays before comparisons, which would return arrays."""
        original = keywords[keyword]

        def check(validator: object, wanted: object, instance: object, schema: object) -> Iterator[ValidationError]:
            comparable = instance.tolist() if hasattr(instance, "tolist") else instance
            yield from original(validator, wanted, comparable, schema) or ()

        return check

    checker = Draft202012Validator.TYPE_CHECKER.redefine_many(
        {
            "array": lambda _, value: isinstance(value, (list, tuple)),
            "boolean": lambda _, value: isinstance(value, bool) or _scalar_kind(value) == "b",
            "integer": lambda _, value: (
                (type(value) is not bool and isinstance(value, int)) or _scalar_kind(value) in "iu"
            ),
            "number": lambda _, value: (
                (type(value) is not bool and isinstance(value, (int, float)) and _is_finite(value))
                or _scalar_kind(value) in "iuf"
            ),
            "object": lambda _, value: isinstance(value, Mapping),
        }
    )
    own = {
        "x-array": x_array,
        "properties": scoped("properties"),
        "enum": words_only("enum"),
        "const": words_only("const"),
    }
    return cast("Callable[..., Validator]", extend(Draft202012Validator, own, type_checker=checker))  # type: ignore[no-untyped-call]


def _is_finite(value: float) -> bool:
    """Tell whether a number is finite: YAML has .inf and .nan."""
    return isinstance(value, int) or math.isfinite(value)


def _scalar_kind(value: object) -> str:
    """Return the dtype kind of a numpy scalar, "-" for anything else; most documents need no numpy."""
    return str(value.dtype.kind) if getattr(value, "shape", None) == () and hasattr(value, "dtype") else "-"


def _array_message(spec_entry: Schema, instance: object) -> str | None:
    """Return how a value differs from `{shape, dtype}`, or None; binds the symbols of a matching shape."""
    shape, dtype = spec_entry["shape"], spec_entry["dtype"]
    array = _as_array(instance, dtype)
    expected = shape_text(spec_entry)
    if array is None:
        return f"expected {expected}, got {describe_value(instance)}"
    got = f"({', '.join(map(str, array.shape))}{',' if array.ndim == 1 else ''}) {array.dtype}"
    if not _dtype_fits(array, instance, dtype) or array.ndim != len(shape):
        return f"expected {expected}, got {got}"
    scopes = _scopes.get()
    bound: dict[str, int] = {}
    for size, entry in zip(array.shape, shape, strict=True):
        bound_size = entry if isinstance(entry, int) else {**scopes.of(entry), **bound}.get(entry)
        if bound_size is None:
            bound[entry] = size
        elif bound_size != size:
            note = "" if isinstance(entry, int) else f" with {entry} = {bound_size}"
            return f"expected {expected}{note}, got {got}"
    for symbol, size in bound.items():
        scopes.of(symbol)[symbol] = size
    return None


def shape_text(entry: Schema) -> str:
    """Return an `x-array` as text: `(H, W, 3) uint8`."""
    shape = entry["shape"]
    dtype = "numbers" if entry["dtype"] == "number" else entry["dtype"]
    return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''}) {dtype}"


def _as_array(instance: object, dtype: str) -> np.ndarray | None:
    """Convert a value to an array, or return None if it is none."""
    import numpy as np

    if isinstance(instance, np.ndarray):
        return instance
    if isinstance(instance, (bytes, bytearray, memoryview)):
        return np.frombuffer(instance, dtype=np.uint8) if dtype == "uint8" else None
    if not isinstance(instance, (list, tuple)) or _holds_flags(instance):
        return None
    try:
        return np.asarray(instance)
    except ValueError:  # ragged
        return None


def _holds_flags(values: object) -> bool:
    """Tell whether nested lists contain a bool, which numpy would convert to a number."""
    if isinstance(values, (list, tuple)):
        return any(_holds_flags(value) for value in values)
    return isinstance(values, bool)


def _dtype_fits(array: np.ndarray, instance: object, dtype: str) -> bool:
    if isinstance(instance, (list, tuple)):
        # A list has no dtype: its numbers have to be convertible to the expected one.
        if dtype == "uint8":
            return array.size == 0 or (array.dtype.kind in "iu" and array.min() >= 0 and array.max() <= 255)
        return array.dtype.kind in _KINDS["number"]
    return array.dtype.kind in _KINDS[dtype] and (dtype != "uint8" or array.dtype.itemsize == 1)


# -- YAML files --------------------------------------------------------------------------------------------------------


def validate_yaml_file(path: Path, schema_name: str) -> list[Problem]:
    """Return the problems of a YAML file with their lines and columns: syntax, repeated keys, and the schema's.

    Raises:
        OSError: if the file cannot be read.
    """
    with path.open("rb") as stream:
        content = stream.read(text.MOST_BYTES + 1)
    return validate_yaml(content, str(path), schema_name)[1]


def validate_yaml(content: bytes, file: str, schema_name: str) -> tuple[Any, list[Problem]]:
    """Return the content of a YAML document and its problems; None if it cannot be parsed.

    Args:
        content: the document.
        file: name of its file in problems.
        schema_name: its schema.
    """
    page = page_of(schema_name)
    try:
        document = text.read(content)
    except yaml.MarkedYAMLError as error:
        line, column = (1, 1) if (mark := error.problem_mark) is None else (mark.line + 1, mark.column + 1)
        return None, [Problem((), f"not valid YAML: {error.problem}", file=file, line=line, column=column, page=page)]
    if document.root is None:
        message = "the file is empty: expected a map"
        return None, [Problem((), message, "a map", "nothing", file=file, line=1, column=1, page=page)]
    data, root = document.data, document.root
    problems = validate(data, schema_name)
    marked = [*_repeated_keys(root), *((problem, mark_of(root, problem.path)) for problem in problems)]
    placed = [
        replace(problem, file=file, line=mark.line + 1, column=mark.column + 1, page=page_of(schema_name, problem))
        for problem, mark in marked
    ]
    return unknown.known(data) if schema_name == _OPEN else data, sorted(
        placed, key=lambda problem: (problem.line or 0, problem.column or 0)
    )


def _of_variants(document: Entry, problems: Sequence[Problem]) -> Iterator[Problem]:
    """Yield problems of policy.yml or deploy.yml that only occur with a variant."""
    named = document.get("variants")
    patches = (
        [name for name, patch in named.items() if isinstance(patch, Mapping)] if isinstance(named, Mapping) else []
    )
    for name in patches:
        merged, patch = variants.apply_variant(document, name)
        path = ("variants", str(name))
        yield from (replace(one, path=(*path, *one.path)) for one in validate(merged, _OPEN) if one not in problems)
        of_deploy = [one for one in validate(patch, "deploy") if one.missing is None]
        yield from (replace(one, path=(*path, "deploy", *one.path)) for one in of_deploy)


def _unknown(problem: Problem, gaps: Mapping[unknown.KeyPath, str]) -> Problem:
    """Return a problem, with the document's reason for a missing key that is declared unknown."""
    path = (*problem.path, problem.missing) if problem.missing is not None else ()
    if path not in gaps:
        return problem
    return replace(problem, path=path, message=f"unknown: {gaps[path]}")


def page_of(schema_name: str, problem: Problem | None = None) -> str:
    """Return the documentation page of a kind of document, with the key of a problem as its anchor."""
    page = f"docs/reference/{schema_name.partition('#')[0]}.md"
    known = spec.schema(schema_name.partition("#")[0]).get("properties", {})
    key = problem.path[0] if problem is not None and problem.path else None
    return f"{page}#{key}" if key in known else page


def _repeated_keys(root: yaml.Node) -> Iterator[tuple[Problem, yaml.Mark]]:
    """Yield duplicate keys of maps, which YAML forbids and parsers ignore."""
    waiting: list[tuple[yaml.Node, tuple[str | int, ...]]] = [(root, ())]
    seen: set[int] = set()
    while waiting:
        node, path = waiting.pop()
        if id(node) in seen:  # an alias
            continue
        seen.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            waiting += [(item, (*path, index)) for index, item in enumerate(node.value)]
        if not isinstance(node, yaml.MappingNode):
            continue
        first: dict[Any, int] = {}
        for key, value in node.value:
            name = key.value if isinstance(key, yaml.ScalarNode) else None
            if name in first:
                message = f"the key {name!r} is given twice, first in line {first[name]}"
                yield Problem((*path, str(name)), message, got=str(name)), key.start_mark
            elif name is not None:
                first[name] = key.start_mark.line + 1
            waiting.append((value, (*path, str(name))))


def mark_of(root: yaml.Node, path: tuple[str | int, ...]) -> yaml.Mark:
    """Return the mark of the key or list entry at `path` below a node of YAML, or of the nearest enclosing one."""
    node, mark = root, root.start_mark
    for part in path:
        if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            mark = node.start_mark
            continue
        entries = node.value if isinstance(node, yaml.MappingNode) else []
        entry = next(((key, value) for key, value in entries if key.value == str(part)), None)
        if entry is None:
            break
        mark, node = entry[0].start_mark, entry[1]
    return mark
