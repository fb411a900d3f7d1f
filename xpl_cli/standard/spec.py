"""The standard, read from `spec/`: schemas, conventions, wire, package layout, requirements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Literal

from xpl import json_text, registry
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.yaml import text as yaml_text

if TYPE_CHECKING:
    from pathlib import Path

Schema = Mapping[str, Any]
"""A JSON Schema, or a part of one."""
VERSION: Final = "v1"
"""The version of the standard: the folder in `spec/`, and what `spec` in manifests says."""


@dataclass(frozen=True)
class Requirement:
    """One MUST or SHOULD of the standard.

    Attributes:
        harm: what a package does that violates it, a name of `harms`; empty if that is not said.
    """

    id: str
    level: Literal["MUST", "SHOULD"]
    source: str
    harm: str
    text: str

    @property
    def area(self) -> str:
        """What it is about, in the plural, such as `observations`."""
        name = self.id.split("-")[1]
        return str(data("requirements")["areas"].get(name, name))


def folder() -> Path:
    """Return the folder of the standard."""
    return content_folder("spec") / VERSION


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
def data(name: str) -> dict[str, Any]:
    """Return `<name>.yml` as a map: conventions, wire, package or requirements."""
    parsed: dict[str, Any] = read_yaml(folder() / f"{name}.yml")
    return parsed


@cache
def schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema `<name>.schema.json`."""
    parsed: dict[str, Any] = json_text.parse((folder() / f"{name}.schema.json").read_bytes())
    if name == "model_io" and registry.entries(registry.CONVENTIONS):
        from xpl.catalogue.convention import installed  # which needs numpy

        for one in installed():
            parsed["$defs"]["convention"]["oneOf"].append({"const": one.name, "description": one.about})
            for definition, properties in one.schema.items():
                parsed["$defs"][definition]["properties"].update(properties)
    return parsed


def schema_names() -> list[str]:
    """Return the names of all schemas, sorted."""
    return sorted(path.name.removesuffix(".schema.json") for path in folder().glob("*.schema.json"))


@cache
def requirements() -> dict[str, Requirement]:
    """Return every requirement by its stable id."""
    return {
        key: Requirement(key, entry["level"], entry["source"], entry.get("harm", ""), entry["text"])
        for key, entry in data("requirements")["requirements"].items()
    }


@cache
def harms() -> dict[str, str]:
    """Return the kinds of harm, worst first, each with what a package does that causes it."""
    named: dict[str, str] = data("requirements")["harms"]
    return named


def text(file: str) -> str:
    """Return a YAML file as it is written, for people."""
    return (folder() / file).read_text(encoding="utf-8")
