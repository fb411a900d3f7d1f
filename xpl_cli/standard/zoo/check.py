"""Checks of the zoo itself: every file fits its schema, and what two files say of one policy agrees."""

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
    """Yield every fault of the zoo, by file."""
    named = set(zoo.schema("policy")["properties"]["family"]["properties"]["value"]["enum"])
    for family in sorted(named ^ set(zoo.families())):
        yield Problem(("families", family), "named in words.yml or in policy.schema.json alone", file="zoo/words.yml")
    for name in ("policy", "proof"):
        yield from _files(name)


def _files(kind: str) -> Iterator[Problem]:
    from jsonschema import Draft202012Validator

    validator = Draft202012Validator(zoo.schema(kind))
    place = zoo.folder() / ("policies" if kind == "policy" else "proofs")
    for path in sorted(place.iterdir()) if place.is_dir() else ():
        shown = f"zoo/{place.name}/{path.name}"
        try:
            told = _read(path)
        except (yaml.YAMLError, ValueError) as error:
            yield Problem((), f"cannot be read: {error}", file=shown)
            continue
        problems = [problem for error in validator.iter_errors(told) for problem in explain(error)]
        yield from (replace(problem, file=shown) for problem in problems)
        if problems:
            continue
        if told["name"] != path.stem:
            yield Problem(("name",), f"expected the file's name {path.stem}, got {told['name']!r}", file=shown)
        yield from (replace(problem, file=shown) for problem in (_facts if kind == "policy" else _proof)(told))


def _read(path: Path) -> Any:
    """Return what a file holds.

    Raises:
        ValueError: if it is no file of the zoo.
    """
    if path.suffix == ".yml" and path.parent.name == "policies":
        return spec.read_yaml(path)
    if path.suffix == ".json" and path.parent.name == "proofs":
        return json_text.parse(path.read_bytes())
    raise ValueError("no part of the zoo")


def _facts(told: dict[str, Any]) -> Iterator[Problem]:
    """Yield what facts of a policy contradict."""
    adapter = told.get("adapter", {}).get("value")
    if adapter is not None and adapter["folder"] != f"policy/{told['name']}":
        message = f"expected policy/{told['name']}, got {adapter['folder']!r}"
        yield Problem(("adapter", "value", "folder"), message)
    for robot in told.get("robots", {}).get("value", ()):
        if robot not in robots.entries():
            yield Problem(("robots", "value"), f"there is no robot {robot!r}")


def _proof(told: zoo.ZooProof) -> Iterator[Problem]:
    """Yield what a proof says that cannot have come out of a run."""
    if not (zoo.folder() / "policies" / f"{told['name']}.yml").is_file():
        yield Problem(("name",), f"the zoo has no policy {told['name']!r}")
    ran = {gate["gate"] for gate in told["gates"] if gate["digest"] is not None and _SERVES not in gate["not_run"]}
    needed = ("static", "offline")[: told["level"]]
    for gate in needed:
        if gate not in ran:
            yield Problem(("level",), f"level {told['level']} needs the {gate} gate, which did not run")
    if (told["level"] == len(zoo.levels()) - 1) is not (told["next"] is None):
        yield Problem(("next",), "it says why the next level is not reached, and nothing at the last one")
    if (told["level"] == len(zoo.levels()) - 1) is not ("run" in told):
        yield Problem(("run",), "the last level has a recorded run, and no other one has")
