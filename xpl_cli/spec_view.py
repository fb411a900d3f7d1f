"""The standard as people read it: an index, requirements as a table, schemas as an outline."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from xpl_cli import spec
from xpl_cli.errors import NotFoundError
from xpl_cli.validate import registry, shape_text

_PARTS = {
    "conventions": "orders, units, frames, defaults of behaviour",
    "package": "files and scripts of an adapter",
    "requirements": "every MUST and SHOULD",
    "wire": "requests, answers, errors, encoding of arrays",
}


@dataclass(frozen=True)
class View:
    """A part of the standard: its data, and its text."""

    value: Any
    text: Callable[[], str]


def view(name: str | None, version: str = spec.CURRENT) -> View:
    """Return the part of the standard that `name` names: schema, part, requirement or embodiment; None is the index.

    Raises:
        NotFoundError: with the nearest names.
    """
    if name is None:
        index = _index(version)
        return View(index, lambda: _index_text(index))
    if name == "requirements":
        rows = [asdict(entry) for entry in spec.requirements(version).values()]
        return View(rows, lambda: _table([(row["id"], row["level"], row["text"]) for row in rows]))
    if name in _PARTS:
        return View(spec.data(name, version), (spec.folder(version) / f"{name}.yml").read_text)
    if name in spec.schema_names(version):
        schema = spec.schema(name, version)
        return View(schema, lambda: _schema_text(schema, version))
    if name in spec.requirements(version):
        requirement = spec.requirements(version)[name]
        return View(
            asdict(requirement), lambda: f"{name} ({requirement.level}, {requirement.source}): {requirement.text}"
        )
    for stem, entry in spec.embodiments(version).items():
        if name in (stem, *entry.get("aliases", ())):
            return View(entry, (spec.folder(version) / "embodiments" / f"{stem}.yml").read_text)
    raise _unknown(name, version)


def _unknown(name: str, version: str) -> NotFoundError:
    from xpl_cli.problems import nearest

    known = [*_PARTS, *spec.schema_names(version), *spec.embodiments(version), *spec.requirements(version)]
    near = nearest(name, known)
    hint = f"did you mean {near}?" if near else "`xpl spec show` lists what there is"
    return NotFoundError(f"the standard has no {name!r}", hint=hint)


def _index(version: str) -> dict[str, Any]:
    return {
        "version": version,
        "parts": _PARTS,
        "schemas": {name: spec.schema(name, version)["title"] for name in spec.schema_names(version)},
        "embodiments": {name: entry.get("description", "") for name, entry in spec.embodiments(version).items()},
        "requirements": len(spec.requirements(version)),
    }


def _index_text(index: Mapping[str, Any]) -> str:
    lines = [f"spec {index['version']}, {index['requirements']} requirements; `xpl spec show NAME` shows one of:"]
    for heading in ("parts", "schemas", "embodiments"):
        lines += ["", heading, _table([(f"  {name}", text) for name, text in index[heading].items()])]
    return "\n".join(lines)


def _schema_text(schema: Mapping[str, Any], version: str) -> str:
    return "\n".join(
        [f"{schema['title']}: {schema.get('description', '')}", "", *_outline(schema, schema["$id"], version)]
    )


def _outline(schema: Mapping[str, Any], base: str, version: str) -> Iterator[str]:
    """Yield the lines of a schema: its keys, or its alternatives and definitions where it has none."""
    if "properties" in schema:
        yield _table(list(_rows(schema, base, version, "")))
        return
    options = schema.get("oneOf") or [{"$ref": f"#/$defs/{name}"} for name in schema.get("$defs", ())]
    for option in options:
        target = _resolve(option, base, version)
        yield option["$ref"].rpartition("/")[2]
        if "properties" in target:
            yield _table(list(_rows(target, base, version, "  ")))
        else:
            yield f"    {_kind(target, base, version)}"
    if not options:
        yield _kind(schema, base, version)


def _rows(schema: Mapping[str, Any], base: str, version: str, indent: str) -> Iterator[tuple[str, str, str]]:
    for key, entry in schema.get("properties", {}).items():
        resolved = _resolve(entry, base, version)
        mark = "*" if key in schema.get("required", ()) else " "
        text = entry.get("description", resolved.get("description", ""))
        default = f" (default {_word(entry['default'])})" if "default" in entry else ""
        yield f"{indent}{mark} {key}", _kind(entry, base, version), f"{text}{default}"
        if "$ref" not in entry:
            yield from _rows(entry, base, version, f"{indent}  ")


def _kind(entry: Mapping[str, Any], base: str, version: str) -> str:
    """Write what a value may be, in a few words."""
    resolved = _resolve(entry, base, version)
    if "x-array" in resolved:
        return shape_text(resolved["x-array"])
    if "enum" in resolved:
        return " | ".join(_word(item) for item in resolved["enum"])
    if "const" in resolved:
        return _word(resolved["const"])
    for keyword in ("anyOf", "oneOf"):
        if keyword in resolved:
            return " | ".join(_kind(option, base, version) for option in resolved[keyword])
    types = resolved.get("type", "any")
    name = types if isinstance(types, str) else " | ".join(types)
    items = resolved.get("items")
    return f"{name} of {_kind(items, base, version)}" if name == "array" and items else name


def _resolve(entry: Mapping[str, Any], base: str, version: str) -> Mapping[str, Any]:
    if "$ref" not in entry:
        return entry
    found = registry(version).resolver(base_uri=base).lookup(entry["$ref"])
    contents: Mapping[str, Any] = found.contents
    return contents


def _word(value: Any) -> str:
    import json

    return value if isinstance(value, str) else json.dumps(value)


def _table(rows: list[tuple[str, ...]]) -> str:
    """Align all columns but the last, which may be long."""
    if not rows:
        return ""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    lines = (
        "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]]) for row in rows
    )
    return "\n".join(line.rstrip() for line in lines)
