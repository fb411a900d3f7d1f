"""The standard, read from `spec/`: schemas, conventions, wire, package layout, requirements, embodiments."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import yaml

from xpl_cli.content import room

if TYPE_CHECKING:
    from pathlib import Path

CURRENT = "v1"
"""The spec version that this release scaffolds and audits by."""

_MOST_LEVELS = 100
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class Requirement:
    """One MUST or SHOULD of the standard."""

    id: str
    level: Literal["MUST", "SHOULD"]
    source: str
    text: str


def folder(version: str = CURRENT) -> Path:
    """Return the folder of one spec version."""
    return room("spec") / version


def read_yaml(path: Path) -> Any:
    """Parse one YAML file (see `parse_yaml`)."""
    return parse_yaml(path.read_bytes())


def parse_yaml(content: bytes | str) -> Any:
    """Parse YAML with the safe loader (libyaml's where it is built in).

    Raises:
        yaml.YAMLError: if it is not YAML, or nested deeper than any honest document: libyaml's composer would overflow
            the stack of the process.
    """
    depth = 0
    for event in yaml.parse(content, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MOST_LEVELS:
            raise yaml.YAMLError(f"nested more than {_MOST_LEVELS} levels deep")
    return yaml.load(content, Loader=_Loader)  # noqa: S506 - _Loader is a safe loader


@cache
def data(name: str, version: str = CURRENT) -> dict[str, Any]:
    """Return `spec/<version>/<name>.yml` as a map: conventions, wire, package or requirements."""
    parsed: dict[str, Any] = read_yaml(folder(version) / f"{name}.yml")
    return parsed


@cache
def schema(name: str, version: str = CURRENT) -> dict[str, Any]:
    """Return the JSON Schema `spec/<version>/<name>.schema.json`."""
    parsed: dict[str, Any] = json.loads((folder(version) / f"{name}.schema.json").read_text(encoding="utf-8"))
    return parsed


def schema_names(version: str = CURRENT) -> list[str]:
    """Return the names of all schemas of a version, sorted."""
    return sorted(path.name.removesuffix(".schema.json") for path in folder(version).glob("*.schema.json"))


@cache
def requirements(version: str = CURRENT) -> dict[str, Requirement]:
    """Return every requirement by its stable id."""
    return {
        key: Requirement(id=key, level=entry["level"], source=entry["source"], text=entry["text"])
        for key, entry in data("requirements", version)["requirements"].items()
    }


@cache
def embodiments(version: str = CURRENT) -> dict[str, dict[str, Any]]:
    """Return every embodiment's data by name, each whole: what it has from the one it is `like` is filled in."""
    paths = sorted((folder(version) / "embodiments").glob("*.yml"))
    entries = {path.stem: read_yaml(path) for path in paths}
    return {name: entries.get(entry.pop("like", None), {}) | entry for name, entry in entries.items()}
