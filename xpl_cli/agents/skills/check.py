"""Whether agents find the skills of this version: stale copies, broken links, skills that are left out unseen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from xpl_cli import __version__
from xpl_cli.agents.skills import instructions, places, specification
from xpl_cli.agents.skills.bundle import FILE, Bundle, bundles, read
from xpl_cli.agents.skills.placing import Condition, condition, stamp

_FRAME: Final = 8
"""Characters around a name and a description in an agent's list."""


@dataclass(frozen=True)
class Finding:
    """What keeps a skill from an agent, or gives it another one.

    Attributes:
        kind: `stale`, `edited`, `foreign`, `broken`, `unlinked`, `dropped`, `invalid`, `rules` or `budget`.
        path: where.
        message: one sentence.
        fix: what to do; a command where one does it.
        fails: whether it counts: what is said of other people's skills, and what may be meant so, is told only.
    """

    kind: str
    path: Path
    message: str
    fix: str
    fails: bool = True


@dataclass(frozen=True)
class Listing:
    """What an agent's list of skills takes of its context.

    Attributes:
        agent: name of the agent.
        skills: how many it finds.
        characters: length of its list.
        budget: length up to which it shows all of it; None if it does not say.
    """

    agent: str
    skills: int
    characters: int
    budget: int | None


@dataclass(frozen=True)
class _Site:
    """The places of one scope."""

    scope: places.Scope
    base: Path

    @property
    def renew(self) -> str:
        """The command that puts things right here."""
        return "xpl skills install" + (" --user" if self.scope == "user" else "")

    def place(self, folder: str) -> Path:
        """Return where a folder of skills is, or would be."""
        return places.place(self.base, folder, self.scope)

    def entries(self, folder: str) -> list[Path]:
        """Return what lies in a folder of skills; what begins with a dot is none."""
        path = self.place(folder)
        return sorted(entry for entry in path.iterdir() if entry.name[0] != ".") if path.is_dir() else []


class Check:
    """Looks at a project and at the user's own skills.

    Args:
        project: top of the project.
        home: the user's home.
    """

    def __init__(self, project: Path, home: Path) -> None:
        self._project = project
        self._sites = (_Site("project", project), _Site("user", home))
        self._bundles = {bundle.name: bundle for bundle in bundles()}

    def installed(self) -> bool:
        """Tell whether any skill of ours is in any of the places."""
        return any(self._has_ours(site) for site in self._sites)

    def findings(self) -> list[Finding]:
        """Return all that is wrong; what fails comes first."""
        found = [finding for site in self._sites for finding in self._in(site)]
        if self._has_ours(self._sites[0]):
            found += _instructions(self._project)
        found += _over_budget(self.listings(), self._project)
        return sorted(found, key=lambda finding: not finding.fails)

    def listings(self) -> list[Listing]:
        """Return how long the list of skills is that each agent shows."""
        return [_listing(agent, self._sites) for agent in places.AGENTS]

    def _has_ours(self, site: _Site) -> bool:
        return any(entry.name in self._bundles for folder in places.FOLDERS for entry in site.entries(folder))

    def _in(self, site: _Site) -> Iterator[Finding]:
        for folder in places.FOLDERS:
            for entry in site.entries(folder):
                bundle = self._bundles.get(entry.name)
                if not entry.exists():
                    fix = f"remove it, then {site.renew}" if bundle else f"remove it, or mend {entry.readlink()}"
                    yield Finding("broken", entry, "the link leads nowhere", fix, fails=bundle is not None)
                    continue
                # What a link to the store shows is judged there.
                if bundle and entry.resolve() != _resolved(site.place(places.STORE) / entry.name, entry):
                    written = folder in {places.STORE, places.CLAUDE}
                    yield from _compared(entry, bundle, site.renew if written else f"remove it, then {site.renew}")
                if entry.is_dir():
                    yield from _against_specification(entry, ours=bundle is not None)
        yield from self._unlinked(site)

    def _unlinked(self, site: _Site) -> Iterator[Finding]:
        """Yield skills that Claude Code does not find although it has others of ours."""
        stored = {entry.name for entry in site.entries(places.STORE)} & self._bundles.keys()
        linked = {entry.name for entry in site.entries(places.CLAUDE)} & self._bundles.keys()
        for name in sorted(stored - linked) if linked else []:
            told = "Claude Code has other skills of xpl here, and not this one"
            yield Finding("unlinked", site.place(places.CLAUDE) / name, told, f"{site.renew} {name}")


def _resolved(store: Path, entry: Path) -> Path | None:
    """Return where the store has a skill, unless `entry` is that place itself."""
    return None if entry == store else store.resolve()


def _compared(entry: Path, bundle: Bundle, renew: str) -> Iterator[Finding]:
    """Yield how an entry with the name of a skill of ours differs from the skill."""
    match condition(entry, bundle):
        case Condition.STALE:
            version = (stamp(entry) or {}).get("version")
            told = f"it belongs to xpl {version}, and this is {__version__}"
            yield Finding("stale", entry, told if version != __version__ else "it is an older text", renew)
        case Condition.EDITED:
            yield Finding("edited", entry, "it was edited after installation", f"{renew} --overwrite replaces it")
        case Condition.FOREIGN:
            told = "it has the name of a skill of xpl, and neither its text nor the stamp of `xpl skills install`"
            yield Finding("foreign", entry, told, f"move it away, then {renew}")


def _against_specification(entry: Path, *, ours: bool) -> Iterator[Finding]:
    for problem in specification.problems(entry):
        kind = "dropped" if problem.dropped else "invalid"
        fix = "mend it: agents leave such a skill out and do not say so" if problem.dropped else "mend it"
        yield Finding(kind, entry / FILE, problem.message, fix, fails=ours)


def _instructions(project: Path) -> Iterator[Finding]:
    path = project / instructions.FILE
    match instructions.condition(project):
        case Condition.STALE:
            yield Finding("rules", path, "its block for xpl is that of another version", "xpl skills install")
        case Condition.ABSENT:
            yield Finding("rules", path, "it has no block for xpl", "xpl skills install", fails=False)
    if path.is_file() and not instructions.is_imported(project):
        told = f"it does not import {instructions.FILE}, so that Claude Code does not read the rules"
        fix = f"add the line {instructions.IMPORT}"
        yield Finding("rules", project / instructions.CLAUDE_FILE, told, fix, fails=False)
    if path.is_file() and path.stat().st_size > places.INSTRUCTIONS_LIMIT:
        told = f"it has {path.stat().st_size} bytes, of which Codex reads {places.INSTRUCTIONS_LIMIT}"
        yield Finding("budget", path, told, "shorten it", fails=False)


def _listing(agent: places.Agent, sites: Sequence[_Site]) -> Listing:
    found: dict[Path, int] = {}
    for site in sites:
        for folder in agent.folders(site.scope):
            for entry in site.entries(folder):
                try:
                    bundle = read(entry)
                except (OSError, ValueError):
                    continue
                shown = min(len(bundle.description), agent.shown)
                found[entry.resolve()] = len(bundle.name) + shown + _FRAME
    return Listing(agent.name, len(found), sum(found.values()), agent.listing)


def _over_budget(listings: Sequence[Listing], project: Path) -> Iterator[Finding]:
    for listing in listings:
        if listing.budget is not None and listing.characters > listing.budget:
            told = (
                f"{listing.agent} finds {listing.skills} skills; its list of them has {listing.characters} characters, "
                f"and it shows about {listing.budget}: descriptions are cut, or skills left out"
            )
            yield Finding("budget", project, told, "remove skills that you do not use", fails=False)
