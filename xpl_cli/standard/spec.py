"""The standard, read from `spec/`: schemas, conventions, wire, package layout, requirements, embodiments.

A version is a folder. One that extends another holds only what it changes: a map is merged into the older map, anything
else takes the older one's place, and `{+: [...]}` adds to a list. Whoever reads a version reads all of it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

from xpl_cli.basics.content import room
from xpl_cli.basics.yaml import text as yaml_text

if TYPE_CHECKING:
    from pathlib import Path

RECORD_SUFFIX = ".sha256"
"""A version is frozen by the file `spec/<version>.sha256`, which `sha256sum --check` takes."""

_ABOUT = "version"
_ADDED = "+"
_VERSION = re.compile(r"v([0-9]+)(?:\.([0-9]+))?")
_IDENTIFIER = re.compile(r"^xpl:v[0-9.]+/")


@dataclass(frozen=True)
class Requirement:
    """One MUST or SHOULD of the standard."""

    id: str
    level: Literal["MUST", "SHOULD"]
    source: str
    text: str


@cache
def versions() -> tuple[str, ...]:
    """Return every version of the standard, oldest first."""
    found = (path.name for path in room("spec").iterdir() if path.is_dir() and _VERSION.fullmatch(path.name))
    return tuple(sorted(found, key=order))


def published() -> tuple[str, ...]:
    """Return the versions that are frozen, oldest first: what is promised, and what pages tell of."""
    return tuple(filter(is_frozen, versions()))


def order(version: str) -> tuple[int, int]:
    """Return what versions are ordered by."""
    found = _VERSION.fullmatch(version)
    if found is None:
        raise ValueError(f"a version is written v1 or v1.1, got {version!r}")
    return int(found[1]), int(found[2] or 0)


def is_frozen(version: str) -> bool:
    """Tell whether a version is published, and so must not change any more."""
    return (room("spec") / f"{version}{RECORD_SUFFIX}").is_file()


def _newest() -> str:
    """Return the newest version that is frozen: one that is still being written is used only where it is named."""
    return max(published(), key=order, default=versions()[-1])


CURRENT = _newest()
"""The spec version that this release scaffolds by, and that the SDK's constants are compiled from."""

NEWEST = versions()[-1]
"""The newest version, which may still be being written: by it this release writes its own documents, to which a version
only adds, and it knows every requirement that a rule proves."""


def declared(manifest: Mapping[str, Any]) -> str:
    """Return the version that an adapter is held to: the one its manifest names.

    An adapter without a manifest promised nothing newer than the oldest version. A version that is not known is
    reported where the manifest is validated; everything else then goes by the newest.
    """
    given = manifest.get("spec")
    if given is None:
        return versions()[0]
    return given if given in versions() else CURRENT


def folder(version: str = CURRENT) -> Path:
    """Return the folder of one spec version; it may hold only what the version changes."""
    return room("spec") / version


@cache
def about(version: str) -> dict[str, Any]:
    """Return what a version says of itself: what it extends, its date, its changes; nothing for the first one."""
    path = folder(version) / f"{_ABOUT}.yml"
    parsed: dict[str, Any] = read_yaml(path) if path.is_file() else {}
    return parsed


@cache
def lineage(version: str) -> tuple[str, ...]:
    """Return a version and all that it builds on, the first one first."""
    parent = about(version).get("extends")
    return (version,) if parent is None else (*lineage(parent), version)


def newest_path(place: Path, version: str, name: str) -> Path:
    """Return a file of a version where every version has a folder below `place`: its own one, or that it inherits.

    Raises:
        FileNotFoundError: if neither it nor what it builds on has the file.
    """
    candidates = [place / one / name for one in reversed(lineage(version))]
    found = next((path for path in candidates if path.is_file()), None)
    if found is None:
        raise FileNotFoundError(f"no version up to {version} has {name} in {place}")
    return found


def read_yaml(path: Path) -> Any:
    """Parse one YAML file (see `parse_yaml`)."""
    return parse_yaml(path.read_bytes())


def parse_yaml(content: bytes | str) -> Any:
    """Return what a YAML document holds.

    Raises:
        yaml.YAMLError: if it is not YAML, or larger, deeper or more tangled than any honest document.
    """
    return yaml_text.parse(content)


@cache
def data(name: str, version: str = CURRENT) -> dict[str, Any]:
    """Return `<name>.yml` of a version as a map: conventions, wire, package or requirements."""
    merged: dict[str, Any] = _merged(name + ".yml", version)
    return merged


@cache
def schema(name: str, version: str = CURRENT) -> dict[str, Any]:
    """Return the JSON Schema `<name>.schema.json` of a version."""
    merged: dict[str, Any] = _renamed(_merged(f"{name}.schema.json", version), version)
    return merged


def schema_names(version: str = CURRENT) -> list[str]:
    """Return the names of all schemas of a version, sorted."""
    paths = (path for one in lineage(version) for path in folder(one).glob("*.schema.json"))
    return sorted({path.name.removesuffix(".schema.json") for path in paths})


@cache
def requirements(version: str = CURRENT) -> dict[str, Requirement]:
    """Return every requirement by its stable id."""
    return {
        key: Requirement(id=key, level=entry["level"], source=entry["source"], text=entry["text"])
        for key, entry in data("requirements", version)["requirements"].items()
    }


def requirement(name: str) -> Requirement:
    """Return a requirement as the newest version says it; one that no frozen version has, as it is being written.

    Raises:
        KeyError: if no version has it.
    """
    known = next((one for one in (CURRENT, *reversed(versions())) if name in requirements(one)), CURRENT)
    return requirements(known)[name]


@cache
def embodiments(version: str = CURRENT) -> dict[str, dict[str, Any]]:
    """Return every embodiment's data by name, each whole: what it has from the one it is `like` is filled in."""
    entries = embodiment_entries(version)
    return {
        name: entries.get(entry.get("like", name), {}) | {key: value for key, value in entry.items() if key != "like"}
        for name, entry in entries.items()
    }


@cache
def embodiment_entries(version: str = CURRENT) -> dict[str, dict[str, Any]]:
    """Return what is written about every embodiment by name, with `like` where it shares the arm of another one."""
    stems = {path.stem for one in lineage(version) for path in (folder(one) / "embodiments").glob("*.yml")}
    return {stem: _merged(f"embodiments/{stem}.yml", version) for stem in sorted(stems)}


def text(file: str, version: str) -> str:
    """Return a YAML file of a version for people; what several versions wrote comes without their comments."""
    layers = [path for one in lineage(version) if (path := folder(one) / file).is_file()]
    if len(layers) == 1:
        return layers[0].read_text(encoding="utf-8")
    import yaml

    merged: str = yaml.safe_dump(_merged(file, version), sort_keys=False, allow_unicode=True)
    return merged


def _merged(file: str, version: str) -> Any:
    """Return a file of a version: that of the oldest one, with what the later ones change."""
    layers = [path for one in lineage(version) if (path := folder(one) / file).is_file()]
    if not layers:
        raise FileNotFoundError(f"{version} of the standard has no {file}")
    read = json.loads if file.endswith(".json") else parse_yaml
    result = read(layers[0].read_bytes())
    for path in layers[1:]:
        result = merge(result, read(path.read_bytes()))
    return result


def merge(value: Any, change: Any) -> Any:
    """Return a value with a change of a later version in it."""
    if isinstance(value, dict) and isinstance(change, dict):
        return {**value, **{key: merge(value.get(key), entry) for key, entry in change.items()}}
    if isinstance(value, list) and isinstance(change, dict) and set(change) == {_ADDED}:
        return [*value, *change[_ADDED]]
    return change


def _renamed(value: Any, version: str) -> Any:
    """Return a schema whose identifier and references name this version, also where an older one wrote them."""
    if isinstance(value, dict):
        return {
            key: _IDENTIFIER.sub(f"xpl:{version}/", entry)
            if key in ("$id", "$ref") and isinstance(entry, str)
            else _renamed(entry, version)
            for key, entry in value.items()
        }
    return [_renamed(entry, version) for entry in value] if isinstance(value, list) else value
