"""Registry of extensions by name: built-in ones, and entry points of installed packages.

A package registers in a group in its pyproject.toml, without a change of `xpl`:

    [project.entry-points."xpl.wires"]
    tiny = "my_package.wire:WIRE"

Wires are objects; formats and conventions are modules; they are imported on first use. Rules, environments and robots
are content: their entry points name a folder within a package, which is searched and never imported.
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
BUILT_IN_DISTRIBUTION = "xpl"
"""Distribution of the built-in entries."""


class EntryPointError(RuntimeError):
    """An entry point cannot be used, or two have one name; the message names the distributions."""


@dataclass(frozen=True)
class RegisteredEntry:
    """One entry, not imported yet.

    Attributes:
        group: one of the groups above.
        name: its name in the group.
        value: `package.module:object`, `package.module`, or `package.folder` in groups of folders.
        distribution: name and version of the distribution that registered it.
    """

    group: str
    name: str
    value: str
    distribution: str

    def load(self) -> Any:
        """Import the object, or the module if the value names no object.

        Raises:
            EntryPointError: it cannot be imported.
        """
        module, _, attribute = self.value.partition(":")
        try:
            value: Any = importlib.import_module(module.strip())
            for part in attribute.strip().split(".") if attribute else ():
                value = getattr(value, part)
        except Exception as error:
            raise self.unusable(f"{type(error).__name__}: {error}") from error
        return value

    def folder(self) -> Path:
        """Return the folder that the value names; nothing is imported.

        Raises:
            EntryPointError: there is no such folder.
        """
        top, *parts = self.value.split(".")
        try:
            module_spec = importlib.util.find_spec(top)
        except (ImportError, ValueError) as error:
            raise self.unusable(f"{type(error).__name__}: {error}") from None
        for location in (module_spec.submodule_search_locations if module_spec else None) or ():
            folder = Path(location, *parts)
            if folder.is_dir():
                return folder
        raise self.unusable(f"there is no folder {'/'.join(parts) or '.'} in a package {top}")

    def unusable(self, problem: str) -> EntryPointError:
        """Return the error about this entry point, in one line."""
        text = " ".join(problem.split())
        return EntryPointError(
            f"the entry point {self.name} = {self.value!r} ({self.group}) of {self.distribution} cannot be used: {text}"
        )


def entries(group: str, built_in: Mapping[str, str] | None = None) -> dict[str, RegisteredEntry]:
    """Return the entries of a group by name: built-in ones, then those of installed packages.

    Args:
        group: one of the groups above.
        built_in: values of the built-in entries, by name.

    Raises:
        EntryPointError: two entries have the same name.
    """
    registered = {
        name: RegisteredEntry(group, name, value, BUILT_IN_DISTRIBUTION) for name, value in (built_in or {}).items()
    }
    for entry in _installed():
        if entry.group != group:
            continue
        other = registered.setdefault(entry.name, entry)
        if other is not entry:
            raise EntryPointError(
                f"two are called {entry.name} in {group}: {other.value!r} of {other.distribution} and {entry.value!r} "
                f"of {entry.distribution}; uninstall one of them"
            )
    return registered


def find(group: str, name: str, built_in: Mapping[str, str] | None = None) -> RegisteredEntry | None:
    """Return the entry of a name, None if there is none; installed packages are searched only if it is not built in.

    Args:
        group: one of the groups above.
        name: name of the entry.
        built_in: values of the built-in entries, by name.

    Raises:
        EntryPointError: two entries of the group have the same name.
    """
    if built_in and name in built_in:
        return RegisteredEntry(group, name, built_in[name], BUILT_IN_DISTRIBUTION)
    return entries(group, built_in).get(name)


def folders(group: str) -> dict[Path, RegisteredEntry]:
    """Return the folders that installed packages register in a group, with their entries.

    Raises:
        EntryPointError: a folder does not exist, or two entries have the same name.
    """
    return {entry.folder(): entry for entry in entries(group).values()}


@cache
def _installed() -> tuple[RegisteredEntry, ...]:
    """Return the entry points of xpl's groups in this Python; the first distribution of a name on the path counts."""
    return tuple(_read_entry_points())


def _read_entry_points() -> Iterator[RegisteredEntry]:
    from importlib import metadata  # imported here: slow

    # Without the working directory, which `python -m` puts first and which may hold untrusted files.
    here = Path.cwd()
    paths = [place for place in sys.path if place and Path(place).resolve() != here]
    names: set[str] = set()
    for distribution in metadata.distributions(path=paths):
        # Few distributions have any: read more than this file only of those.
        if "[xpl." not in (distribution.read_text("entry_points.txt") or ""):
            continue
        name = distribution.metadata["Name"]
        if name in names:
            continue
        names.add(name)
        for point in distribution.entry_points:
            if point.group in (RULES, WIRES, ENVS, ROBOTS, FORMATS, CONVENTIONS):
                yield RegisteredEntry(point.group, point.name, point.value, f"{name} {distribution.version}")
