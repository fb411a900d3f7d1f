"""Installation of skills into agents' folders, without overwriting files of others.

Skills are written to `.agents/skills`, and Claude Code gets a link to each. A stamp file in every bundle has the
digests of what was written: an unchanged bundle can be renewed, an edited one belongs to the user.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import json_text
from xpl_cli import __version__
from xpl_cli.agents.skills import locations
from xpl_cli.agents.skills.bundle import STAMP, SkillBundle, contents
from xpl_cli.basics import atomic

if TYPE_CHECKING:
    from collections.abc import Iterable

_SCHEMA = "xpl.skill/1"


class Condition(StrEnum):
    """State of an installed skill compared with the current one."""

    ABSENT = "absent"
    CURRENT = "current"
    STALE = "stale"
    EDITED = "edited"
    FOREIGN = "foreign"
    BROKEN = "broken"


@dataclass(frozen=True)
class InstallResult:
    """The result, or planned result, of one installation.

    Attributes:
        path: of the installed skill.
        state: `written`, `renewed`, `linked`, `copied`, `unchanged` or `left`.
        why: why it was left unchanged, for `left`.
    """

    path: Path
    state: str
    why: str | None = None


def condition(path: Path, bundle: SkillBundle) -> Condition:
    """Compare the content of a path with a bundle."""
    if path.is_symlink() and not path.exists():
        return Condition.BROKEN
    if not path.exists():
        return Condition.ABSENT
    if not path.is_dir():
        return Condition.FOREIGN
    installed_files = contents(path)
    if installed_files == contents(bundle.folder):
        return Condition.CURRENT
    stamped = stamp(path)
    if stamped is None:
        return Condition.FOREIGN
    return Condition.STALE if stamped["files"] == _digests(installed_files) else Condition.EDITED


def stamp(path: Path) -> dict[str, Any] | None:
    """Return the stamp of a bundle that `xpl skills install` wrote; None if there is none."""
    try:
        record = json_text.parse((path / STAMP).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    ours = isinstance(record, dict) and record.get("schema") == _SCHEMA and isinstance(record.get("files"), dict)
    return record if ours else None


@dataclass(frozen=True)
class Installation:
    """Installs bundles in one scope.

    Args:
        base: the project's root, or the user's home.
        scope: project or user.
        copy: give Claude Code copies instead of links.
        overwrite: replace installed bundles that were edited.
        dry_run: write nothing.
    """

    base: Path
    scope: locations.Scope
    copy: bool = False
    overwrite: bool = False
    dry_run: bool = False

    def install(self, bundles: Iterable[SkillBundle], agents: Iterable[str]) -> list[InstallResult]:
        """Install each bundle for these agents, and return the results."""
        store, links = (
            locations.skills_folder(self.base, folder, self.scope) for folder in (locations.STORE, locations.CLAUDE)
        )
        results = []
        for bundle in bundles:
            results.append(self._write(store / bundle.name, bundle, "written"))
            if "claude" in agents:
                results.append(self._link(links / bundle.name, store / bundle.name, bundle))
        return results

    def _link(self, link: Path, target: Path, bundle: SkillBundle) -> InstallResult:
        if link.exists() and target.exists() and link.resolve() == target.resolve():
            return InstallResult(link, "unchanged")
        if link.is_symlink():
            return InstallResult(link, "left", f"a link to {link.readlink()}")
        if self.copy or link.exists():
            return self._write(link, bundle, "copied")
        if not self.dry_run:
            link.parent.mkdir(parents=True, exist_ok=True)
            try:
                # Relative, so that it works in every clone of the project.
                link.symlink_to(os.path.relpath(target, link.parent.resolve()), target_is_directory=True)
            except OSError:
                return self._write(link, bundle, "copied")
        return InstallResult(link, "linked")

    def _write(self, path: Path, bundle: SkillBundle, state: str) -> InstallResult:
        """Write a bundle to a path that is free, or has an unchanged installed bundle."""
        match condition(path, bundle):
            case Condition.CURRENT:
                return InstallResult(path, "unchanged")
            case Condition.FOREIGN | Condition.BROKEN as found:
                return InstallResult(path, "left", f"it is {found} and was not written by `xpl skills install`")
            case Condition.EDITED if not self.overwrite:
                return InstallResult(path, "left", "it was edited; --overwrite replaces it")
            case Condition.STALE | Condition.EDITED:
                state = "renewed"
        if not self.dry_run:
            _write(path, bundle)
        return InstallResult(path, state)


def _write(path: Path, bundle: SkillBundle) -> None:
    files = contents(bundle.folder)
    record = {"schema": _SCHEMA, "version": __version__, "files": _digests(files)}
    with atomic.replaced_folder(path) as folder:
        for name, content in {**files, STAMP: json.dumps(record, indent=2).encode() + b"\n"}.items():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)


def _digests(files: dict[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
