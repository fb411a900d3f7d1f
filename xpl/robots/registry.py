"""Every robot by its names: ours, and those that a project or an installed package offers."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import json_text, registry
from xpl.robots import shipped
from xpl.robots.entry import faults, inherit

if TYPE_CHECKING:
    from xpl.contract import Entry

OURS = registry.BUILT_IN_DISTRIBUTION
"""Where a robot comes from that no file of a project or package describes."""

HANDED_ON = "XPL_EMBODIMENTS"
"""Environment variable by which processes get the robots of a project: a JSON list of `[origin, entry]`."""

_MOST_BYTES = 1 << 20
_MOST_HANDED = 96 << 10
"""Letters in which all robots are handed on: no process starts with a variable of 128 KiB (execve(2))."""
_SUFFIXES = (".yml", ".json")
_offered: dict[str, tuple[str, dict[str, Any]]] = {}  # name: origin, entry
_heard: list[str] = []  # what was handed on, as far as it was read


class RobotError(ValueError):
    """An entry is none of a robot, or its name is taken."""


def entries() -> dict[str, Entry]:
    """Return what is known of every robot, by name: ours first, then a project's."""
    _listen()
    return {**shipped.entries(), **{name: entry for name, (_, entry) in _offered.items()}}


def names() -> dict[str, str]:
    """Return every word that stands for a robot, aliases and names of benchmarks included, with the robot's name."""
    _listen()
    return {**_fixed(), **{word: name for name, (_, entry) in _offered.items() for word in _words(name, entry)}}


def canonical(name: object) -> str | None:
    """Return the name of the robot that a word stands for; None where no robot is called so.

    Raises:
        EntryPointError: the name is unknown, and the robots of an installed package cannot be read.
    """
    if not isinstance(name, str):
        return None
    return _known(name) or (_known(name) if _bring() else None)


def origin(name: str) -> str:
    """Return where a robot comes from: "xpl", or the file that describes it.

    Raises:
        KeyError: if there is no robot of this name.
    """
    if name in shipped.entries():
        return OURS
    _listen()
    return _offered[name][0]


def offer(entry: Entry, origin: str) -> str:
    """Make a robot known in this process and those that it starts; return its name.

    Args:
        entry: its facts, as a file of the standard has them; with `like`, what is not said is as for that robot.
        origin: where they were read, for messages.

    Raises:
        RobotError: the entry is not one, its name or an alias stands for another robot, or all take too much room.
    """
    robot = whole(entry)
    problem = next(iter(faults(robot)), None)
    if problem is not None:
        raise RobotError(f"{origin}: {problem}")
    name = robot["name"]
    if _offered.get(name, ("", None))[1] == robot:
        return str(name)
    for word in _words(name, robot):
        if (taken := names().get(word)) is not None:
            raise RobotError(
                f"{origin}: the name {word} is taken by {taken}, which {_whose(taken)}: choose another name"
            )
    offered = {**_offered, name: (origin, robot)}
    handed = json.dumps([[where, told] for where, told in offered.values()])
    if len(handed) > _MOST_HANDED:
        raise RobotError(
            f"{origin}: with it the robots of projects and packages take {len(handed)} bytes as JSON, expected "
            f"{_MOST_HANDED} at most: describe fewer, or in fewer words"
        )
    _offered.update(offered)
    os.environ[HANDED_ON] = handed
    _heard[:] = [handed]
    return str(name)


def load(path: str | Path) -> str:
    """Make the robot that a file describes known (see `offer`); return its name.

    Args:
        path: a YAML file, which takes PyYAML to read, or a JSON file.

    Raises:
        RobotError: the file is too large, holds no robot, or one whose name is taken.
        RuntimeError: PyYAML is not installed in this Python.
    """
    path = Path(path)
    with path.open("rb") as stream:
        content = stream.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise RobotError(f"{path}: expected at most {_MOST_BYTES} bytes")
    if path.suffix == ".json":
        try:
            return offer(_map(json_text.parse(content), str(path)), str(path))
        except json_text.JsonError as error:
            raise RobotError(f"{path}: {error}") from None
    try:
        import yaml
    except ImportError:
        raise RuntimeError(f"reading {path} takes PyYAML: pip install PyYAML, or write it as .json") from None
    try:
        document = yaml.safe_load(content)
    except yaml.YAMLError as error:
        raise RobotError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    return offer(_map(document, str(path)), str(path))


@cache
def _bring() -> bool:
    """Make the robots of installed packages known, once; tell whether there are any."""
    waiting = [
        (path, source)
        for folder, source in registry.folders(registry.ROBOTS).items()
        for path in sorted(folder.iterdir())
        if path.suffix in _SUFFIXES
    ]
    is_any = bool(waiting)
    while waiting:
        problems = {one: problem for one in waiting if (problem := _problem(*one)) is not None}
        if len(problems) == len(waiting):  # nothing that is left can be like another one any more
            raise next(iter(problems.values()))
        waiting = list(problems)
    return is_any


def _problem(path: Path, source: registry.RegisteredEntry) -> registry.EntryPointError | None:
    """Make the robot of an installed package known; return why that cannot be done, or None."""
    try:
        load(path)
    except (OSError, RuntimeError, ValueError) as error:
        return source.unusable(str(error))
    return None


def whole(entry: Entry) -> dict[str, Any]:
    """Return an entry with what it has from the robot that it is `like`: map by map, and its own words first.

    Raises:
        RobotError: there is no such robot.
    """
    other = entry.get("like")
    if other is None:
        return dict(entry)
    base = entries().get(_known(str(other)) or "")
    if base is None:
        raise RobotError(f"{entry.get('name')} is to be like {other!r}, and there is no such robot")
    return inherit(base, entry)


def _listen() -> None:
    """Add the robots that the parent process passed on."""
    handed = os.environ.get(HANDED_ON, "")
    if not handed or handed in _heard:
        return
    _heard[:] = [handed]
    try:
        entries = json_text.parse(handed)
    except ValueError:
        raise RobotError(f"{HANDED_ON} is not what the tool writes; unset it") from None
    for where, entry in entries:
        if not any(faults(entry)) and entry["name"] not in _fixed():
            _offered.setdefault(entry["name"], (where, entry))


def _known(word: str) -> str | None:
    return _fixed().get(word) or names().get(word)


@cache
def _fixed() -> dict[str, str]:
    """Return the words for robots that are always there."""
    own = {word: name for name, entry in shipped.entries().items() for word in _words(name, entry)}
    return {**shipped.words(), **own}


def _words(name: str, entry: Entry) -> tuple[str, ...]:
    return (name, *(entry.get("aliases") or ()))


def _whose(name: str) -> str:
    where = origin(name)
    return "comes with xpl" if where == OURS else f"{where} describes"


def _map(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise RobotError(f"{where}: expected a map that describes a robot, got {type(value).__name__}")
    return value
