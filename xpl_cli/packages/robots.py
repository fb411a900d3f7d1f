"""Robots of projects and packages: `embodiments/NAME.yml` beside `policy/` and `envs/`, or within a package.

Installed packages add robots, too: NAME.yml in the folders of their entry points (`xpl.registry`). All are equivalent
to those of the standard, and are passed to every child process (`xpl.robots`).
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import json_text, registry
from xpl import robots as sdk_robots
from xpl.ecosystem import checkout
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.packages.manifests import ManifestError, content_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from xpl.contract import Config, Entry

FOLDER: Final = "embodiments"
DESCRIPTION: Final = "embodiment_description"
"""Key of a recorded run's configuration with the description of a project's robot."""
_PACKAGE_FOLDERS: Final = ("policy", "envs")
_CHECKOUT_ROBOTS: Final = Path("utils", "robot", "_robot_info.json")
"""In a checkout of the ecosystem: dimensions of robots by name."""
_ARMS: Final = {1: ["single"], 2: ["left", "right"]}
_MOST_JOINTS: Final = 64
_MOST_FILES: Final = 64
_MOST_BYTES: Final = 1 << 20
"""Largest total size of the robots of a folder; one with `like` is read again until its base is registered."""

_read: dict[Path, tuple[int, int]] = {}  # files read already: modification time and size


def register_robots(package: Path | None = None) -> None:
    """Register the robots of a package, its project, the working directory and installed packages.

    Args:
        package: folder of an adapter or an environment.

    Raises:
        ManifestError: if a file describes no valid robot; lists all problems.
        UserError: if a name is taken, or a folder has too many robots.
        EntryPointError: if an installed package's robots cannot be used.
    """
    for folder, source in registry.folders(registry.ROBOTS).items():
        try:
            _register_folder(folder, f" of {source.distribution}")
        except UserError as error:
            raise source.unusable(str(error)) from None
    for folder in dict.fromkeys(_folders(package)):
        _register_folder(folder)
    if package is not None and (root := checkout.find_root(package.resolve())) is not None:
        _register_checkout(root / _CHECKOUT_ROBOTS)


def _register_checkout(path: Path) -> None:
    """Register the robots that only a checkout of the ecosystem names, by their dimensions; the rest is not known.

    An entry that the standard cannot express, such as arms of different joints, is left out.
    """
    try:
        content = path.read_bytes() if path.stat().st_size <= _MOST_BYTES else b""
        named = json_text.parse(content)
    except (OSError, json_text.JsonError):
        return
    for name, entry in list(named.items())[:_MOST_FILES] if isinstance(named, dict) else ():
        arms, hands = (_uniform(entry.get(key)) if isinstance(entry, dict) else [] for key in ("arm_dim", "ee_dim"))
        if sdk_robots.canonical(name) is not None or len(arms) != len(hands) or len(arms) not in _ARMS:
            continue
        described = {
            "name": name,
            "description": f"A robot of which {path.name} of a checkout tells the dimensions alone.",
            "arms": _ARMS[len(arms)],
            "arm": {"dof": arms[0], "joints": None, "home": None},
            "end_effector": {"kind": "parallel_gripper" if hands[0] == 1 else "hand", "dim": hands[0], "stroke": None},
        }
        with contextlib.suppress(sdk_robots.RobotError):
            sdk_robots.offer(described, _display_path(path))


def _uniform(dimensions: object) -> list[int]:
    """Return a list of one positive dimension, once for each arm; empty if a value is none."""
    if not isinstance(dimensions, list):
        return []
    is_one = all(isinstance(one, int) and 0 < one <= _MOST_JOINTS and one == dimensions[0] for one in dimensions)
    return dimensions if is_one else []


def canonical_name(word: str | None, package: Path | None = None) -> str | None:
    """Return the canonical name of a robot; the given name if there is no such robot.

    Args:
        word: a name or alias, such as a benchmark's.
        package: folder of an adapter or environment, which may not exist yet.
    """
    register_robots(package)
    return None if word is None else sdk_robots.canonical(word) or word


def recorded_description(name: str) -> dict[str, Any]:
    """Return the configuration entry that describes a project's robot in a recorded run; empty for robots of xpl."""
    if sdk_robots.origin(name) == sdk_robots.OURS:
        return {}
    return {DESCRIPTION: dict(sdk_robots.entries()[name])}


def register_recorded(config: Config, where: str) -> None:
    """Register the robot of a recorded run, if necessary.

    Args:
        config: the configuration of the run.
        where: source of the configuration, for messages.

    Raises:
        UserError: if another robot has that name, or the entry is malformed.
    """
    entry = config.get(DESCRIPTION)
    if entry is None:
        return
    if not isinstance(entry, dict):
        raise UserError(f"{where} describes no robot under {DESCRIPTION}", code=ExitCode.NOT_RUN)
    here = sdk_robots.entries().get(str(entry.get("name")))
    if here is not None and dict(here) != entry:
        raise UserError(
            f"{entry['name']} is another robot here than in {where}: its description differs", code=ExitCode.NOT_RUN
        )
    try:
        sdk_robots.offer(entry, where)
    except sdk_robots.RobotError as error:
        raise UserError(str(error), code=ExitCode.NOT_RUN) from None


def robot_files(package: Path | None = None) -> list[Path]:
    """Return the robot files of a package, its project and the working directory."""
    return [path for folder in dict.fromkeys(_folders(package)) for path in sorted(folder.glob("*.yml"))]


def _folders(package: Path | None) -> Iterator[Path]:
    yield (Path.cwd() / FOLDER).resolve()
    if package is not None:
        folder = package.resolve()
        if folder.parent.name in _PACKAGE_FOLDERS:
            yield folder.parent.parent / FOLDER
        yield folder / FOLDER


def _register_folder(folder: Path, whose: str = "") -> None:
    """Register the robots of a folder; `whose` names their distribution in messages."""
    if not folder.is_dir():
        return
    from xpl_cli.standard import robots as reader

    waiting = {path: _state(path) for path in sorted(folder.glob("*.yml"))}
    waiting = {path: state for path, state in waiting.items() if _read.get(path) != state}
    if len(waiting) > _MOST_FILES:
        raise UserError(f"{_display_path(folder)} describes {len(waiting)} robots, expected {_MOST_FILES} at most")
    contents: dict[Path, bytes] = {path: content_of(path) or b"" for path in waiting}
    if (size := sum(map(len, contents.values()))) > _MOST_BYTES:
        raise UserError(
            f"{_display_path(folder)} describes robots in {size} bytes, expected {_MOST_BYTES} at most in all"
        )
    while contents:
        others: Mapping[str, Entry] = sdk_robots.entries()
        parsed = {path: reader.read(content, _display_path(path), others) for path, content in contents.items()}
        ready = {path: entry for path, (entry, _) in parsed.items() if entry is not None}
        if not ready:  # no remaining robot can be completed
            path, (_, problems) = next(iter(parsed.items()))
            raise ManifestError(Path(_display_path(path)), "embodiment", problems)
        for path, entry in ready.items():
            try:
                sdk_robots.offer(entry, _display_path(path) + whose)
            except sdk_robots.RobotError as error:
                raise UserError(str(error), code=ExitCode.USAGE) from None
            _read[path] = waiting[path]
            del contents[path]


def _state(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size


def _display_path(path: Path) -> str:
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)
