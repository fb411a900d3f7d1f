"""Robots of projects and packages: `embodiments/NAME.yml` beside `policy/` and `envs/`, or within a package.

Installed packages bring robots, too: NAME.yml in the folders that their entry points name (`xpl.registry`). All are as
good as those of the standard everywhere. What is read here is handed on to every process that is started
(`xpl.robots`).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import registry
from xpl import robots as sdk_robots
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.packages.manifests import ManifestError, content_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from xpl.contract import Config, Entry

FOLDER: Final = "embodiments"
DESCRIPTION: Final = "embodiment_description"
"""Key of a recorded run's configuration that holds a robot of the project, so that it can be met again."""
_ROOMS: Final = ("policy", "envs")
_MOST_FILES: Final = 64
_MOST_BYTES: Final = 1 << 20
"""Of all robots of a folder. One that is like another is read again until that one is known."""

_read: dict[Path, tuple[int, int]] = {}  # what was read already: time and size


def register_robots(package: Path | None = None) -> None:
    """Make the robots known that a package and its project, the working directory and installed packages describe.

    Args:
        package: folder of an adapter or an environment.

    Raises:
        ManifestError: a file does not describe a robot; all problems are told, with their lines.
        UserError: the name of one is taken, or a folder has more of them than any project.
        EntryPointError: an installed package's robots cannot be used.
    """
    for folder, source in registry.folders(registry.ROBOTS).items():
        try:
            _register_folder(folder, f" of {source.distribution}")
        except UserError as error:
            raise source.unusable(str(error)) from None
    for folder in dict.fromkeys(_folders(package)):
        _register_folder(folder)


def canonical_name(word: str | None, package: Path | None = None) -> str | None:
    """Return the name of the robot that a word stands for; the word itself where none is called so.

    Args:
        word: what the user wrote, such as a benchmark's name of a robot.
        package: folder of an adapter or environment, which need not exist yet.
    """
    register_robots(package)
    return None if word is None else sdk_robots.canonical(word) or word


def recorded_description(name: str) -> dict[str, Any]:
    """Return what the configuration of a recorded run says of its robot: its entry, if only the project knows it."""
    if sdk_robots.origin(name) == sdk_robots.OURS:
        return {}
    return {DESCRIPTION: dict(sdk_robots.entries()[name])}


def register_recorded(config: Config, where: str) -> None:
    """Make the robot of a recorded run known where it is not.

    Args:
        config: the configuration of the run.
        where: what recorded it, for messages.

    Raises:
        UserError: a robot of that name is here, and another one; or the entry is none.
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
    """Return the files that describe robots of a package, its project and the working directory."""
    return [path for folder in dict.fromkeys(_folders(package)) for path in sorted(folder.glob("*.yml"))]


def _folders(package: Path | None) -> Iterator[Path]:
    yield (Path.cwd() / FOLDER).resolve()
    if package is not None:
        place = package.resolve()
        if place.parent.name in _ROOMS:
            yield place.parent.parent / FOLDER
        yield place / FOLDER


def _register_folder(folder: Path, whose: str = "") -> None:
    """Make the robots of a folder known; `whose` says of which distribution, for messages."""
    if not folder.is_dir():
        return
    from xpl_cli.standard import robots as reader

    waiting = {path: _state(path) for path in sorted(folder.glob("*.yml"))}
    waiting = {path: state for path, state in waiting.items() if _read.get(path) != state}
    if len(waiting) > _MOST_FILES:
        raise UserError(f"{_shown(folder)} describes {len(waiting)} robots, expected {_MOST_FILES} at most")
    contents: dict[Path, bytes] = {path: content_of(path) or b"" for path in waiting}
    if (size := sum(map(len, contents.values()))) > _MOST_BYTES:
        raise UserError(f"{_shown(folder)} describes robots in {size} bytes, expected {_MOST_BYTES} at most in all")
    while contents:
        others: Mapping[str, Entry] = sdk_robots.entries()
        found = {path: reader.read(content, _shown(path), others) for path, content in contents.items()}
        ready = {path: entry for path, (entry, _) in found.items() if entry is not None}
        if not ready:  # nothing that is left can be like another one any more
            path, (_, problems) = next(iter(found.items()))
            raise ManifestError(Path(_shown(path)), "embodiment", problems)
        for path, entry in ready.items():
            try:
                sdk_robots.offer(entry, _shown(path) + whose)
            except sdk_robots.RobotError as error:
                raise UserError(str(error), code=ExitCode.USAGE) from None
            _read[path] = waiting[path]
            del contents[path]


def _state(path: Path) -> tuple[int, int]:
    about = path.stat()
    return about.st_mtime_ns, about.st_size


def _shown(path: Path) -> str:
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)
