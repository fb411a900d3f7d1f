"""JSON Schemas for editors: one self-contained file per manifest.

Language servers of YAML complete and check a manifest by the schema that its first line names. They know draft 7 best,
and neither our references between schemas nor our keyword for arrays.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.standard.spec import Schema

FOLDER = ".xpl"
"""Folder of a package with generated files of xpl."""

MANIFESTS = ("policy", "env", "deploy")
"""The manifests that users write, by their schemas' names."""

Definitions = dict[str, Any]
"""Parts of schemas by their names in a bundle."""
_DIALECT = "http://json-schema.org/draft-07/schema#"
_OWN = "#/$defs/"
_HEAD = ("$schema", "$id", "$defs")
"""Keys of a schema that a bundle omits."""
_KINDS = {"uint8": "integer", "float": "number", "number": "number"}


def path(name: str) -> str:
    """Return the path of a manifest's schema in a package."""
    return f"{FOLDER}/{name}.schema.json"


def render(name: str) -> bytes:
    """Return a schema of the standard as a file for editors."""
    return f"{json.dumps(bundle(name), indent=2)}\n".encode()


def write(folder: Path) -> list[str]:
    """Write the schemas of the manifests that a package has, and return their names.

    Raises:
        UserError: if it has no manifest, or the folder cannot be written.
    """
    there = [name for name in MANIFESTS if (folder / f"{name}.yml").is_file()]
    if not there:
        raise UserError(f"{folder} has none of {', '.join(f'{name}.yml' for name in MANIFESTS)}")
    try:
        (folder / FOLDER).mkdir(exist_ok=True)
        for name in there:
            atomic.write_file(folder / path(name), render(name))
    except OSError as error:
        raise UserError(f"{folder / FOLDER} cannot be written: {error.strerror or error}") from None
    return [path(name) for name in there]


def bundle(name: str) -> dict[str, Any]:
    """Return a schema with all its references included, in draft 7."""
    schema = spec.schema(name)
    definitions: Definitions = {}
    body = {key: value for key, value in schema.items() if key not in _HEAD}
    result = _plain(body, name, definitions, name)
    return {"$schema": _DIALECT, **result, "definitions": dict(sorted(definitions.items()))}


def _plain(value: object, name: str, definitions: Definitions, root: str) -> Any:
    """Return a part of schema `name` without references to other files; what it refers to is added to `definitions`."""
    if isinstance(value, list):
        return [_plain(entry, name, definitions, root) for entry in value]
    if not isinstance(value, dict):
        return value
    result = {}
    for key, entry in value.items():
        if key == "$ref":
            result[key] = _referred(entry, name, definitions, root)
        elif key == "x-array":
            result |= _array(entry)
        else:
            result[key] = _plain(entry, name, definitions, root)
    return result


def _referred(reference: str, name: str, definitions: Definitions, root: str) -> str:
    """Add the target of a reference to the definitions, and return the new reference."""
    other, _, pointer = reference.partition("#")
    home = other.rpartition("/")[2] or name
    key = pointer.removeprefix(_OWN[1:]).replace("/", ".") or "whole"
    label = key if home == root else f"{home}.{key}"
    if label not in definitions:
        definitions[label] = {}  # before following its own references, which may be recursive
        target: Any = spec.schema(home)
        for part in pointer.split("/")[1:]:
            target = target[part]
        dropped = () if pointer else _HEAD
        target = {key: value for key, value in target.items() if key not in dropped}
        definitions[label] = _plain(target, home, definitions, root)
    return f"#/definitions/{label}"


def _array(array: Schema) -> dict[str, Any]:
    """Write an `x-array` as nested lists; sizes that go by a symbol are free."""
    result: dict[str, Any] = {"type": _KINDS[array["dtype"]]}
    for size in reversed(array["shape"]):
        limits = {"minItems": size, "maxItems": size} if isinstance(size, int) else {}
        result = {"type": "array", "items": result, **limits}
    return result
