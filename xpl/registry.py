"""What is registered by name: a table of our own, and what installed packages add with entry points.

A package adds to a group in its pyproject.toml, and no file of `xpl` is touched:

    [project.entry-points."xpl.wires"]
    tiny = "my_package.wire:WIRE"

Wires are objects, formats and conventions modules, which are imported when they are used. Rules, environments and
robots are content: their entry points name a folder within a package, in which they are found by path, and which is
never imported.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

RULES, WIRES, ENVS, ROBOTS, FORMATS = "xpl.rules", "xpl.wires", "xpl.envs", "xpl.robots", "xpl.formats"
CONVENTIONS = "xpl.conventions"
OURS = "xpl"
"""The distribution of what is built in."""


class EntryPointError(RuntimeError):
    """An entry point cannot be used, or two have one name; the message names the distributions."""


@dataclass(frozen=True)
class Entry:
    """One registered thing, not yet imported.

    Attributes:
        group: one of the groups above.
        name: what it is called there.
        value: `package.module:object`, `package.module`, or `package.folder` where the group holds folders.
        distribution: name and version of the distribution that registered it.
    """

    group: str
    name: str
    value: str
    distribution: str

    def load(self) -> Any:
        """Import the object, or the module where the value names no object.

        Raises:
            EntryPointError: it cannot be imported.
        """
        module, _, attribute = self.value.partition(":")
        try:
            found: Any = importlib.import_module(module.strip())
            for part in attribute.strip().split(".") if attribute else ():
                found = getattr(found, part)
        except Exception as error:
            raise self.broken(f"{type(error).__name__}: {error}") from error
        return found

    def folder(self) -> Path:
        """Return the folder that the value names; nothing is imported.

        Raises:
            EntryPointError: there is no such folder.
        """
        top, *parts = self.value.split(".")
        try:
            found = importlib.util.find_spec(top)
        except (ImportError, ValueError) as error:
            raise self.broken(f"{type(error).__name__}: {error}") from None
        for place in (found.submodule_search_locations if found else None) or ():
            folder = Path(place, *parts)
            if folder.is_dir():
                return folder
        raise self.broken(f"there is no folder {'/'.join(parts) or '.'} in a package {top}")

    def broken(self, problem: str) -> EntryPointError:
        """Return the error about this entry point, in one line."""
        said = " ".join(problem.split())
        return EntryPointError(
            f"the entry point {self.name} = {self.value!r} ({self.group}) of {self.distribution} cannot be used: {said}"
        )


def entries(group: str, built_in: Mapping[str, str] | None = None) -> dict[str, Entry]:
    """Return what a group holds, by name: what is built in, then what installed packages register.

    Args:
        group: one of the groups above.
        built_in: our own, as name and value.

    Raises:
        EntryPointError: two have one name.
    """
    found = {name: Entry(group, name, value, OURS) for name, value in (built_in or {}).items()}
    for entry in _installed():
        if entry.group != group:
            continue
        other = found.setdefault(entry.name, entry)
        if other is not entry:
            raise EntryPointError(
                f"two are called {entry.name} in {group}: {other.value!r} of {other.distribution} and {entry.value!r} "
                f"of {entry.distribution}; uninstall one of them"
            )
    return found


def find(group: str, name: str, built_in: Mapping[str, str] | None = None) -> Entry | None:
    """Return what is registered by a name, None if nothing is; packages are only looked for where we have none.

    Raises:
        EntryPointError: two of the group have one name.
    """
    if built_in and name in built_in:
        return Entry(group, name, built_in[name], OURS)
    return entries(group, built_in).get(name)


def folders(group: str) -> dict[Path, Entry]:
    """Return the folders that installed packages register in a group, with who registers them.

    Raises:
        EntryPointError: one cannot be found, or two have one name.
    """
    return {entry.folder(): entry for entry in entries(group).values()}


@cache
def _installed() -> tuple[Entry, ...]:
    """Return the entry points of our groups of all distributions of this Python; the first on its path counts."""
    return tuple(_found())


def _found() -> Iterator[Entry]:
    from importlib import metadata  # as long as all else of a short command

    # Not the working directory, where `python -m` looks first: what lies there may be anybody's.
    here = Path.cwd()
    places = [place for place in sys.path if place and Path(place).resolve() != here]
    known: set[str] = set()
    for distribution in metadata.distributions(path=places):
        # Few have any of ours, and only of those more than this one file is read.
        if "[xpl." not in (distribution.read_text("entry_points.txt") or ""):
            continue
        name = distribution.metadata["Name"]
        if name in known:
            continue
        known.add(name)
        for point in distribution.entry_points:
            if point.group in (RULES, WIRES, ENVS, ROBOTS, FORMATS, CONVENTIONS):
                yield Entry(point.group, point.name, point.value, f"{name} {distribution.version}")
