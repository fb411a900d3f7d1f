"""The files of robots: those of `spec/robots/`, and what a file that describes one has to be.

A robot lies in `spec/robots/NAME.yml`, and `spec/robots/aliases.yml` holds the words of benchmarks. `xpl spec compile`
makes of them what `xpl.robots` knows. Files of projects (`embodiments/NAME.yml`) go through the same reader.
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
    """Return the folder of our robots."""
    return content_folder("spec") / "robots"


@cache
def entries() -> dict[str, dict[str, Any]]:
    """Return what the files say of every robot, by name, each whole: what it has from the one it is `like` included."""
    waiting = {path.stem: spec.read_yaml(path) for path in _files()}
    known: dict[str, dict[str, Any]] = {}
    while ready := [name for name, entry in waiting.items() if entry.get("like") in (None, *known)]:
        for name in ready:
            entry = waiting.pop(name)
            known[name] = robots.inherit(known[entry["like"]], entry) if "like" in entry else entry
    return dict(sorted(known.items()))


@cache
def aliases() -> dict[str, str]:
    """Return what benchmarks call robots where no entry says so, with the robot's name."""
    return dict(spec.read_yaml(folder() / _ALIASES))


def check() -> Iterator[Problem]:
    """Yield every fault of the robots, by file: schema, names, and where numbers are from."""
    taken: dict[str, str] = {}
    whole = entries()
    for path in _files():
        shown = f"robots/{path.name}"
        entry, problems = read(path.read_bytes(), shown, whole)
        yield from problems
        if entry is None:
            continue
        for word in (entry["name"], *entry.get("aliases", ())):
            if word in taken:
                yield Problem((), f"the name {word} is taken by {taken[word]}", file=shown)
            taken[word] = entry["name"]
        if not entry.get("sources"):
            yield Problem(("sources",), "numbers without a source", file=shown)
    for word, name in aliases().items():
        shown = f"robots/{_ALIASES}"
        if word in taken:
            yield Problem((word,), f"the name {word} is taken by {taken[word]}", file=shown)
        if name not in whole:
            yield Problem((word,), f"there is no robot {name!r}", file=shown)


def read(content: bytes, file: str, others: Mapping[str, Entry]) -> tuple[dict[str, Any] | None, list[Problem]]:
    """Return the robot that a file describes, whole, and all that is wrong with the file, with lines.

    Args:
        content: of the file.
        file: how problems name it; its stem has to be the robot's name.
        others: robots that it may be `like`.
    """
    told, problems = validate_yaml(content, file, _SCHEMA)
    if not isinstance(told, dict):
        return None, problems
    base = others.get(str(told.get("like"))) if "like" in told else None
    root = text.read(content).root
    if base is not None:  # parts are enough then; the whole that they make has to fit
        told = robots.inherit(base, told)
        problems = _placed(validate(told, _SCHEMA), root, file)
    arm = told.get("arm")
    if not problems and isinstance(arm, dict):
        sized = validate(told, _SCHEMA, bindings={"DOF": arm["dof"]})
        problems = _placed(sized or list(_contradictions(told, file, base)), root, file)
    if not problems and "like" in told:
        problems = _placed([Problem(("like",), f"there is no robot {told['like']!r} with an arm")], root, file)
    return (None if problems else told), problems


def _contradictions(robot: Entry, file: str, base: Entry | None) -> Iterator[Problem]:
    stem = file.replace("\\", "/").rpartition("/")[2].removesuffix(".yml")
    if robot["name"] != stem:
        yield Problem(("name",), f"expected the file's name {stem}, got {robot['name']!r}", stem, robot["name"])
    joints = robot["arm"]["joints"]
    if joints is not None and len(joints) != robot["arm"]["dof"]:
        yield Problem(("arm", "joints"), f"{len(joints)} joints, but dof is {robot['arm']['dof']}")
    for place, joint in enumerate(joints or ()):
        limits = joint["limits"]
        if limits is not None and not limits[0] < limits[1]:
            yield Problem(("arm", "joints", place, "limits"), f"expected [from, to] in rad, got {limits}")
        axis = joint.get("axis")
        if axis is not None and not 1e-6 < math.hypot(*axis) < 1e6:
            yield Problem(("arm", "joints", place, "axis"), f"expected a direction, got {axis}")
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
