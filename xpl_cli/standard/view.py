"""Text views of the standard: an index, requirements as a table, schemas as an outline."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from xpl import robots
from xpl_cli.basics.errors import UnknownNameError, UnknownTargetError, no_such
from xpl_cli.standard import robots as files
from xpl_cli.standard import spec
from xpl_cli.standard.validate import registry, shape_text
from xpl_cli.standard.vocabulary import vocabularies

if TYPE_CHECKING:
    from referencing._core import Resolver

    from xpl.contract import Entry
    from xpl_cli.standard.spec import Schema

_KIND_WIDTH = 40
PARTS = {
    "conventions": "orders, units, frames, defaults of behaviour",
    "package": "files and scripts of an adapter",
    "requirements": "every MUST and SHOULD",
    "wire": "requests, answers, errors, encoding of arrays",
}


OPEN = " ?"
"""Suffix of the type of a value that may be unknown."""
OPEN_MEANS = "A value with ? may be open: {unknown: why} in its place."


@dataclass(frozen=True)
class SpecView:
    """A part of the standard: its data, and its text."""

    value: Any
    text: Callable[[], str]


def view(name: str | None) -> SpecView:
    """Return a part of the standard by name: schema, part, requirement or embodiment; None for the index.

    Raises:
        UnknownTargetError: if there is none; suggests the nearest names.
    """
    if name is None:
        index = _index()
        return SpecView(index, lambda: _index_text(index))
    if name == "requirements":
        rows = [asdict(entry) for entry in spec.requirements().values()]
        return SpecView(rows, lambda: _table([(row["id"], row["level"], row["text"]) for row in rows]))
    if name in PARTS:
        return SpecView(spec.data(name), partial(spec.text, f"{name}.yml"))
    if name in spec.schema_names():
        schema = spec.schema(name)
        return SpecView(schema, lambda: _schema_text(schema))
    if name in spec.requirements():
        requirement = spec.requirements()[name]
        return SpecView(
            asdict(requirement), lambda: f"{name} ({requirement.level}, {requirement.source}): {requirement.text}"
        )
    return _robot(name)


def _robot(name: str) -> SpecView:
    """Return a robot by its name or an alias."""
    robot = robots.canonical(name)
    if robot is None:
        raise _unknown(name)
    entry = robots.entries()[robot]
    return SpecView(entry, partial(_robot_text, robot, entry))


def _robot_text(name: str, entry: Entry) -> str:
    """Return the file of a robot of xpl, or the complete entry of any other robot."""
    title = f"{name}, from {_from(name)}"
    if robots.origin(name) == robots.OURS:
        text = (files.folder() / f"{name}.yml").read_text(encoding="utf-8")
        other = spec.parse_yaml(text).get("like")
        if other is None:
            return text
        title += f", as {other} but for what its file says"
    return _whole_text(entry, title)


def _whole_text(entry: Entry, title: str) -> str:
    import yaml

    whole = yaml.safe_dump(dict(entry), sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    return f"# {title}\n{whole}"


def _from(robot: str) -> str:
    """Return the origin of a robot as text."""
    where = robots.origin(robot)
    return "spec/robots (comes with xpl)" if where == robots.OURS else where


def _unknown(name: str) -> UnknownNameError:
    names = [*PARTS, *spec.schema_names(), *robots.entries(), *spec.requirements()]
    sentence = f"the standard has no {name!r}"
    return no_such(sentence, name, names, listing="xpl spec show", kind=UnknownTargetError)


def _index() -> dict[str, Any]:
    return {
        "version": spec.VERSION,
        "parts": PARTS,
        "schemas": {name: spec.schema(name)["title"] for name in spec.schema_names()},
        "robots": {
            name: {"description": entry.get("description", ""), "from": _from(name)}
            for name, entry in robots.entries().items()
        },
        "requirements": len(spec.requirements()),
    }


def _index_text(index: Mapping[str, Any]) -> str:
    lines = [f"spec {index['version']}, {index['requirements']} requirements; `xpl spec show NAME` shows one of:"]
    for heading in ("parts", "schemas"):
        lines += ["", heading, _table([(f"  {name}", text) for name, text in index[heading].items()])]
    sources = dict.fromkeys(entry["from"] for entry in index["robots"].values())
    for source in sources:
        rows = [
            (f"  {name}", entry["description"]) for name, entry in index["robots"].items() if entry["from"] == source
        ]
        lines += ["", f"embodiments of {source}", _table(rows)]
    return "\n".join(lines)


@dataclass(frozen=True)
class SchemaRow:
    """A key of a schema.

    Attributes:
        path: the keys that lead to it, itself last.
        required: whether it is required.
        kind: type of its value.
        meaning: its description, with its default.
    """

    path: tuple[str, ...]
    required: bool
    kind: str
    meaning: str


@dataclass(frozen=True)
class SchemaSection:
    """A map of a schema: the whole, or one of its alternatives or definitions, which have a name."""

    name: str | None
    rows: tuple[SchemaRow, ...]
    summary: str = ""


def sections(schema: Schema) -> list[SchemaSection]:
    """Return the keys of a schema, or those of its alternatives and definitions."""
    resolver = registry().resolver(base_uri=schema["$id"])
    if "properties" in schema:
        return [SchemaSection(None, tuple(_rows(schema, resolver)))]
    options = schema.get("oneOf") or [{"$ref": f"#/$defs/{name}"} for name in schema.get("$defs", ())]
    result = []
    for option in options:
        target, at = _resolve(option, resolver)
        summary = f"{_kind(target, at)}  {target.get('description', '')}".rstrip()
        result.append(SchemaSection(option["$ref"].rpartition("/")[2], tuple(_rows(target, at)), summary))
    return result or [SchemaSection(None, (), _kind(schema, resolver))]


def _schema_text(schema: Schema) -> str:
    """Write a schema as an outline; `*` marks required keys."""
    lines = [f"{schema['title']}: {schema.get('description', '')}", ""]
    for section in sections(schema):
        margin = "" if section.name is None else "  "
        rows = [
            (
                f"{margin}{'  ' * (len(row.path) - 1)}{'*' if row.required else ' '} {row.path[-1]}",
                row.kind,
                row.meaning,
            )
            for row in section.rows
        ]
        lines += [section.name] if section.name is not None else []
        lines.append(_table(rows) if rows else f"{margin * 2}{section.summary}")
    if any(row.kind.endswith(OPEN) for section in sections(schema) for row in section.rows):
        lines += ["", OPEN_MEANS]
    for choice in vocabularies(schema):
        lines += [
            "",
            f"{choice.key}: {choice.meaning}",
            _table([(f"  {word.name}", word.description) for word in choice.values]),
        ]
    return "\n".join(lines)


def _rows(schema: Schema, resolver: Resolver[Any], path: tuple[str, ...] = ()) -> Iterator[SchemaRow]:
    """Yield the rows of a map, each nested map after its key."""
    entries = dict(schema.get("properties", {}))
    if isinstance(schema.get("additionalProperties"), Mapping):
        entries["<any>"] = schema["additionalProperties"]
    for key, entry in entries.items():
        target, at = _resolve(entry, resolver)
        notes = [entry.get("description", target.get("description", ""))]
        kind = _kind(entry, resolver)
        if len(kind) > _KIND_WIDTH:
            notes.append(f"[{kind.removesuffix(OPEN)}]")
            types = target.get("type", "one of")
            kind = (types if isinstance(types, str) else " | ".join(types)) + (OPEN if kind.endswith(OPEN) else "")
        if "default" in entry:
            notes.append(f"(default {_word(entry['default'])})")
        yield SchemaRow((*path, key), key in schema.get("required", ()), kind, " ".join(filter(None, notes)))
        yield from _rows(target, at, (*path, key))
        yield from _rows(*_resolve(target.get("items", {}), at), (*path, key))
        for option in (option for option in target.get("anyOf", ()) if not _is_open(option)):
            chosen, there = _resolve(option, at)
            yield from _rows(chosen, there, (*path, key))
            yield from _rows(*_resolve(chosen.get("items", {}), there), (*path, key))


def _kind(entry: Schema, resolver: Resolver[Any]) -> str:
    """Return the type of a value as short text."""
    target, at = _resolve(entry, resolver)
    if "$ref" in entry and "title" in target:
        return str(target["title"]).lower()
    if "x-array" in target:
        return shape_text(target["x-array"])
    if "enum" in target:
        return " | ".join(_word(item) for item in target["enum"])
    if "const" in target:
        return _word(target["const"])
    for keyword in ("anyOf", "oneOf"):
        if keyword in target:
            options = [option for option in target[keyword] if set(option) != {"required"}]
            kinds = [_kind(option, at) for option in options if not _is_open(option)]
            if kinds:
                return " | ".join(kinds) + (OPEN if len(kinds) < len(options) else "")
    types = target.get("type", "any")
    name = types if isinstance(types, str) else " | ".join(types)
    items = target.get("items")
    return f"{name} of {_kind(items, at)}" if name == "array" and items else name


def _is_open(entry: Schema) -> bool:
    """Tell whether an alternative is that of an unknown value."""
    return str(entry.get("$ref", "")).endswith("/open")


def _resolve(entry: Schema, resolver: Resolver[Any]) -> tuple[Schema, Resolver[Any]]:
    """Follow a reference; return its target and the resolver for that."""
    if "$ref" not in entry:
        return entry, resolver
    resolved = resolver.lookup(entry["$ref"])
    return resolved.contents, resolved.resolver


def _word(value: object) -> str:
    import json

    return value if isinstance(value, str) else json.dumps(value)


def _table(rows: Sequence[tuple[str, ...]]) -> str:
    """Align all columns but the last, which may be long."""
    if not rows:
        return ""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    lines = (
        "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]]) for row in rows
    )
    return "\n".join(line.rstrip() for line in lines)
