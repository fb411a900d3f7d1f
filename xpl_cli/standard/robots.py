"""Robot files: those of `spec/robots/`, and validation of any robot file.

A robot is a file `spec/robots/NAME.yml`, and `spec/robots/aliases.yml` has the names of benchmarks. `xpl spec compile`
compiles them for `xpl.robots`. Files of projects (`embodiments/NAME.yml`) have the same reader.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

from xpl import robots
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.yaml import text
from xpl_cli.standard import spec
from xpl_cli.standard.problems import Problem
from xpl_cli.standard.validate import mark_of, page_of, validate, validate_yaml

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from xpl.contract import Entry

_SCHEMA = "embodiment"
_ALIASES = "aliases.yml"


def folder() -> Path:
    """Return the folder of the standard's robots."""
    return content_folder("spec") / "robots"


@cache
def entries() -> dict[str, dict[str, Any]]:
    """Return every robot by name, complete: with the entries inherited by `like`."""
    waiting = {path.stem: spec.read_yaml(path) for path in _files()}
    complete: dict[str, dict[str, Any]] = {}
    while ready := [name for name, entry in waiting.items() if entry.get("like") in (None, *complete)]:
        for name in ready:
            entry = waiting.pop(name)
            complete[name] = robots.inherit(complete[entry["like"]], entry) if "like" in entry else entry
    return dict(sorted(complete.items()))


@cache
def aliases() -> dict[str, str]:
    """Return further names of robots in benchmarks, with the robot's name."""
    return dict(spec.read_yaml(folder() / _ALIASES))


def check() -> Iterator[Problem]:
    """Yield every problem of the robots, by file: schema, names and sources."""
    taken: dict[str, str] = {}
    whole = entries()
    for path in _files():
        file = f"robots/{path.name}"
        entry, problems = read(path.read_bytes(), file, whole)
        yield from problems
        if entry is None:
            continue
        for word in (entry["name"], *entry.get("aliases", ())):
            if word in taken:
                yield Problem((), f"the name {word} is taken by {taken[word]}", file=file)
            taken[word] = entry["name"]
        if not entry.get("sources"):
            yield Problem(("sources",), "numbers without a source", file=file)
    for word, name in aliases().items():
        file = f"robots/{_ALIASES}"
        if word in taken:
            yield Problem((word,), f"the name {word} is taken by {taken[word]}", file=file)
        if name not in whole:
            yield Problem((word,), f"there is no robot {name!r}", file=file)


def read(content: bytes, file: str, others: Mapping[str, Entry]) -> tuple[dict[str, Any] | None, list[Problem]]:
    """Return the complete robot of a file, and the file's problems with their lines.

    Args:
        content: content of the file.
        file: its name in problems; its stem has to be the robot's name.
        others: robots that `like` may refer to.
    """
    robot, problems = validate_yaml(content, file, _SCHEMA)
    if not isinstance(robot, dict):
        return None, problems
    base = others.get(str(robot.get("like"))) if "like" in robot else None
    root = text.read(content).root
    if base is not None:  # a partial entry is allowed; the merged one has to be valid
        robot = robots.inherit(base, robot)
        problems = _placed(validate(robot, _SCHEMA), root, file)
    arm = robot.get("arm")
    if not problems and isinstance(arm, dict):
        sized = validate(robot, _SCHEMA, bindings={"DOF": arm["dof"]})
        problems = _placed(sized or list(_contradictions(robot, file, base)), root, file)
    if not problems and "like" in robot:
        problems = _placed([Problem(("like",), f"there is no robot {robot['like']!r} with an arm")], root, file)
    return (None if problems else robot), problems


def _contradictions(robot: Entry, file: str, base: Entry | None) -> Iterator[Problem]:
    stem = file.replace("\\", "/").rpartition("/")[2].removesuffix(".yml")
    if robot["name"] != stem:
        yield Problem(("name",), f"expected the file's name {stem}, got {robot['name']!r}", stem, robot["name"])
    joints = robot["arm"]["joints"]
    if joints is not None and len(joints) != robot["arm"]["dof"]:
        yield Problem(("arm", "joints"), f"{len(joints)} joints, but dof is {robot['arm']['dof']}")
    for index, joint in enumerate(joints or ()):
        limits = joint["limits"]
        if limits is not None and not limits[0] < limits[1]:
            yield Problem(("arm", "joints", index, "limits"), f"expected [from, to] in rad, got {limits}")
        axis = joint.get("axis")
        if axis is not None and not 1e-6 < math.hypot(*axis) < 1e6:
            yield Problem(("arm", "joints", index, "axis"), f"expected a direction, got {axis}")
    if base is None:
        yield from (Problem((), fault) for fault in robots.faults(robot))


def _placed(problems: list[Problem], root: Any, file: str) -> list[Problem]:
    marks = [(problem, mark_of(root, problem.path)) for problem in problems]
    return [
        replace(problem, file=file, line=mark.line + 1, column=mark.column + 1, page=page_of(_SCHEMA))
        for problem, mark in marks
    ]


def _files() -> list[Path]:
    return [path for path in sorted(folder().glob("*.yml")) if path.name != _ALIASES]
