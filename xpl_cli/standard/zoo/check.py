"""Checks of the zoo: every file fits its schema, and the files of a policy agree."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import yaml

from xpl import json_text, robots
from xpl_cli.standard import spec
from xpl_cli.standard.problems import Problem, explain
from xpl_cli.standard.zoo import policies as zoo

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_SERVES = "XPL201"
"""The rule that says whether a gate served the adapter."""


def check() -> Iterator[Problem]:
    """Yield every problem of the zoo, by file."""
    named = set(zoo.schema("policy")["properties"]["family"]["properties"]["value"]["enum"])
    for family in sorted(named ^ set(zoo.families())):
        yield Problem(("families", family), "named in words.yml or in policy.schema.json alone", file="zoo/words.yml")
    for name in ("policy", "proof"):
        yield from _files(name)


def _files(kind: str) -> Iterator[Problem]:
    from jsonschema import Draft202012Validator

    validator = Draft202012Validator(zoo.schema(kind))
    folder = zoo.folder() / ("policies" if kind == "policy" else "proofs")
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        file = f"zoo/{folder.name}/{path.name}"
        try:
            entry = _read(path)
        except (yaml.YAMLError, ValueError) as error:
            yield Problem((), f"cannot be read: {error}", file=file)
            continue
        problems = [problem for error in validator.iter_errors(entry) for problem in explain(error)]
        yield from (replace(problem, file=file) for problem in problems)
        if problems:
            continue
        if entry["name"] != path.stem:
            yield Problem(("name",), f"expected the file's name {path.stem}, got {entry['name']!r}", file=file)
        yield from (replace(problem, file=file) for problem in (_facts if kind == "policy" else _proof)(entry))


def _read(path: Path) -> Any:
    """Return the content of a file.

    Raises:
        ValueError: if it is no file of the zoo.
    """
    if path.suffix == ".yml" and path.parent.name == "policies":
        return spec.read_yaml(path)
    if path.suffix == ".json" and path.parent.name == "proofs":
        return json_text.parse(path.read_bytes())
    raise ValueError("no part of the zoo")


def _facts(entry: dict[str, Any]) -> Iterator[Problem]:
    """Yield contradictions between facts of a policy."""
    adapter = entry.get("adapter", {}).get("value")
    if adapter is not None and adapter["folder"] != f"policy/{entry['name']}":
        message = f"expected policy/{entry['name']}, got {adapter['folder']!r}"
        yield Problem(("adapter", "value", "folder"), message)
    for robot in entry.get("robots", {}).get("value", ()):
        if robot not in robots.entries():
            yield Problem(("robots", "value"), f"there is no robot {robot!r}")


def _proof(entry: zoo.ZooProof) -> Iterator[Problem]:
    """Yield entries of a proof that no run can have produced."""
    if not (zoo.folder() / "policies" / f"{entry['name']}.yml").is_file():
        yield Problem(("name",), f"the zoo has no policy {entry['name']!r}")
    ran = {gate["gate"] for gate in entry["gates"] if gate["digest"] is not None and _SERVES not in gate["not_run"]}
    needed = ("static", "offline")[: entry["level"]]
    for gate in needed:
        if gate not in ran:
            yield Problem(("level",), f"level {entry['level']} needs the {gate} gate, which did not run")
    if (entry["level"] == len(zoo.levels()) - 1) is not (entry["next"] is None):
        yield Problem(("next",), "it says why the next level is not reached, and nothing at the last one")
    if (entry["level"] == len(zoo.levels()) - 1) is not ("run" in entry):
        yield Problem(("run",), "the last level has a recorded run, and no other one has")
