"""Put skills where agents look for them, and never over something that is not ours.

Skills lie as files in `.agents/skills`, and Claude Code gets a link for each. A stamp beside every bundle holds the
digests of what was written: a bundle that still has them is ours to renew, and one that was edited is its user's.
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
from xpl_cli.agents.skills import places
from xpl_cli.agents.skills.bundle import STAMP, Bundle, contents
from xpl_cli.basics import atomic

if TYPE_CHECKING:
    from collections.abc import Iterable

_SCHEMA = "xpl.skill/1"


class Condition(StrEnum):
    """How what lies at a skill's place stands to the skill."""

    ABSENT = "absent"
    CURRENT = "current"
    STALE = "stale"
    EDITED = "edited"
    FOREIGN = "foreign"
    BROKEN = "broken"


@dataclass(frozen=True)
class Placed:
    """What was done, or would be done, at one place.

    Attributes:
        path: the place.
        state: `written`, `renewed`, `linked`, `copied`, `unchanged` or `left`.
        why: what was in the way, if it was left alone.
    """

    path: Path
    state: str
    why: str | None = None


def condition(place: Path, bundle: Bundle) -> Condition:
    """Tell what lies at a place."""
    if place.is_symlink() and not place.exists():
        return Condition.BROKEN
    if not place.exists():
        return Condition.ABSENT
    if not place.is_dir():
        return Condition.FOREIGN
    there = contents(place)
    if there == contents(bundle.folder):
        return Condition.CURRENT
    stamped = stamp(place)
    if stamped is None:
        return Condition.FOREIGN
    return Condition.STALE if stamped["files"] == _digests(there) else Condition.EDITED


def stamp(place: Path) -> dict[str, Any] | None:
    """Return what `xpl skills install` noted when it wrote a bundle, or None if it did not."""
    try:
        noted = json_text.parse((place / STAMP).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    ours = isinstance(noted, dict) and noted.get("schema") == _SCHEMA and isinstance(noted.get("files"), dict)
    return noted if ours else None


@dataclass(frozen=True)
class Installation:
    """Puts bundles into the places of one scope.

    Args:
        base: the project's top, or the user's home.
        scope: which of both.
        copy: give Claude Code copies instead of links.
        overwrite: replace bundles of ours that were edited.
        dry_run: only tell.
    """

    base: Path
    scope: places.Scope
    copy: bool = False
    overwrite: bool = False
    dry_run: bool = False

    def put(self, bundles: Iterable[Bundle], agents: Iterable[str]) -> list[Placed]:
        """Put each bundle where these agents find it, and return what was done."""
        store, links = (places.place(self.base, folder, self.scope) for folder in (places.STORE, places.CLAUDE))
        done = []
        for bundle in bundles:
            done.append(self._write(store / bundle.name, bundle, "written"))
            if "claude" in agents:
                done.append(self._link(links / bundle.name, store / bundle.name, bundle))
        return done

    def _link(self, link: Path, target: Path, bundle: Bundle) -> Placed:
        if link.exists() and target.exists() and link.resolve() == target.resolve():
            return Placed(link, "unchanged")
        if link.is_symlink():
            return Placed(link, "left", f"a link to {link.readlink()}")
        if self.copy or link.exists():
            return self._write(link, bundle, "copied")
        if not self.dry_run:
            link.parent.mkdir(parents=True, exist_ok=True)
            try:
                # Relative, so that it holds wherever the project is cloned to.
                link.symlink_to(os.path.relpath(target, link.parent.resolve()), target_is_directory=True)
            except OSError:
                return self._write(link, bundle, "copied")
        return Placed(link, "linked")

    def _write(self, place: Path, bundle: Bundle, state: str) -> Placed:
        """Write a bundle to a place that is free, or ours."""
        match condition(place, bundle):
            case Condition.CURRENT:
                return Placed(place, "unchanged")
            case Condition.FOREIGN | Condition.BROKEN as found:
                return Placed(place, "left", f"it is {found} and was not written by `xpl skills install`")
            case Condition.EDITED if not self.overwrite:
                return Placed(place, "left", "it was edited; --overwrite replaces it")
            case Condition.STALE | Condition.EDITED:
                state = "renewed"
        if not self.dry_run:
            _write(place, bundle)
        return Placed(place, state)


def _write(place: Path, bundle: Bundle) -> None:
    files = contents(bundle.folder)
    noted = {"schema": _SCHEMA, "version": __version__, "files": _digests(files)}
    with atomic.replaced_folder(place) as folder:
        for name, content in {**files, STAMP: json.dumps(noted, indent=2).encode() + b"\n"}.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)


def _digests(files: dict[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
