"""Check of installed skills: stale copies, broken links, and skills that agents silently ignore."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from xpl_cli import __version__
from xpl_cli.agents.skills import instructions, locations, specification
from xpl_cli.agents.skills.bundle import FILE, SkillBundle, bundles, read
from xpl_cli.agents.skills.installation import Condition, condition, stamp

_FRAME: Final = 8
"""Characters that an agent's list adds to a name and a description."""


@dataclass(frozen=True)
class SkillFinding:
    """A problem that keeps a skill from an agent, or gives it another version.

    Attributes:
        kind: `stale`, `edited`, `foreign`, `broken`, `unlinked`, `dropped`, `invalid`, `rules` or `budget`.
        path: of the skill or file.
        message: one sentence.
        fix: what to do, or the command that does it.
        fails: whether it makes the check fail; problems of third-party skills do not.
    """

    kind: str
    path: Path
    message: str
    fix: str
    fails: bool = True


@dataclass(frozen=True)
class SkillListing:
    """The length of an agent's list of skills.

    Attributes:
        agent: name of the agent.
        skills: number of skills that it finds.
        characters: length of its list.
        budget: longest list that it shows completely; None if undocumented.
    """

    agent: str
    skills: int
    characters: int
    budget: int | None


@dataclass(frozen=True)
class _InstallScope:
    """The skill folders of one scope."""

    scope: locations.Scope
    base: Path

    @property
    def renew(self) -> str:
        """The command that repairs this scope."""
        return "xpl skills install" + (" --user" if self.scope == "user" else "")

    def folder_path(self, folder: str) -> Path:
        """Return the path of a skill folder, which may not exist."""
        return locations.skills_folder(self.base, folder, self.scope)

    def entries(self, folder: str) -> list[Path]:
        """Return the entries of a skill folder, without hidden ones."""
        path = self.folder_path(folder)
        return sorted(entry for entry in path.iterdir() if entry.name[0] != ".") if path.is_dir() else []


class SkillCheck:
    """Checks a project's and the user's skills.

    Args:
        project: root folder of the project.
        home: the user's home.
    """

    def __init__(self, project: Path, home: Path) -> None:
        self._project = project
        self._sites = (_InstallScope("project", project), _InstallScope("user", home))
        self._bundles = {bundle.name: bundle for bundle in bundles()}

    def installed(self) -> bool:
        """Tell whether any skill of xpl is installed."""
        return any(self._has_ours(site) for site in self._sites)

    def findings(self) -> list[SkillFinding]:
        """Return all findings; those that fail come first."""
        findings = [finding for site in self._sites for finding in self._in(site)]
        if self._has_ours(self._sites[0]):
            findings += _instructions(self._project)
        findings += _over_budget(self.listings(), self._project)
        return sorted(findings, key=lambda finding: not finding.fails)

    def listings(self) -> list[SkillListing]:
        """Return the length of each agent's list of skills."""
        return [_listing(agent, self._sites) for agent in locations.AGENTS]

    def _has_ours(self, site: _InstallScope) -> bool:
        return any(entry.name in self._bundles for folder in locations.FOLDERS for entry in site.entries(folder))

    def _in(self, site: _InstallScope) -> Iterator[SkillFinding]:
        for folder in locations.FOLDERS:
            for entry in site.entries(folder):
                bundle = self._bundles.get(entry.name)
                if not entry.exists():
                    fix = f"remove it, then {site.renew}" if bundle else f"remove it, or fix {entry.readlink()}"
                    yield SkillFinding("broken", entry, "the link leads nowhere", fix, fails=bundle is not None)
                    continue
                # The target of a link to the store is checked there.
                if bundle and entry.resolve() != _resolved(site.folder_path(locations.STORE) / entry.name, entry):
                    written = folder in {locations.STORE, locations.CLAUDE}
                    yield from _compare(entry, bundle, site.renew if written else f"remove it, then {site.renew}")
                if entry.is_dir():
                    yield from _against_specification(entry, ours=bundle is not None)
        yield from self._unlinked(site)

    def _unlinked(self, site: _InstallScope) -> Iterator[SkillFinding]:
        """Yield skills that Claude Code does not find although it finds other skills of xpl."""
        stored = {entry.name for entry in site.entries(locations.STORE)} & self._bundles.keys()
        linked = {entry.name for entry in site.entries(locations.CLAUDE)} & self._bundles.keys()
        for name in sorted(stored - linked) if linked else []:
            message = "Claude Code has other skills of xpl here, and not this one"
            yield SkillFinding("unlinked", site.folder_path(locations.CLAUDE) / name, message, f"{site.renew} {name}")


def _resolved(store: Path, entry: Path) -> Path | None:
    """Return the resolved path of a skill in the store; None if `entry` is that path."""
    return None if entry == store else store.resolve()


def _compare(entry: Path, bundle: SkillBundle, renew: str) -> Iterator[SkillFinding]:
    """Yield a finding if an installed skill of xpl differs from the current one."""
    match condition(entry, bundle):
        case Condition.STALE:
            version = (stamp(entry) or {}).get("version")
            message = f"it belongs to xpl {version}, and this is {__version__}"
            yield SkillFinding("stale", entry, message if version != __version__ else "it is an older text", renew)
        case Condition.EDITED:
            yield SkillFinding("edited", entry, "it was edited after installation", f"{renew} --overwrite replaces it")
        case Condition.FOREIGN:
            message = "it has the name of a skill of xpl, and neither its text nor the stamp of `xpl skills install`"
            yield SkillFinding("foreign", entry, message, f"move it away, then {renew}")


def _against_specification(entry: Path, *, ours: bool) -> Iterator[SkillFinding]:
    for problem in specification.problems(entry):
        kind = "dropped" if problem.dropped else "invalid"
        fix = "fix it: agents ignore such a skill silently" if problem.dropped else "fix it"
        yield SkillFinding(kind, entry / FILE, problem.message, fix, fails=ours)


def _instructions(project: Path) -> Iterator[SkillFinding]:
    path = project / instructions.FILE
    match instructions.condition(project):
        case Condition.STALE:
            yield SkillFinding("rules", path, "its block for xpl belongs to another version", "xpl skills install")
        case Condition.ABSENT:
            yield SkillFinding("rules", path, "it has no block for xpl", "xpl skills install", fails=False)
    if path.is_file() and not instructions.is_imported(project):
        message = f"it does not import {instructions.FILE}, so that Claude Code does not read the rules"
        fix = f"add the line {instructions.IMPORT}"
        yield SkillFinding("rules", project / instructions.CLAUDE_FILE, message, fix, fails=False)
    if path.is_file() and path.stat().st_size > locations.INSTRUCTIONS_LIMIT:
        message = f"it has {path.stat().st_size} bytes, of which Codex reads {locations.INSTRUCTIONS_LIMIT}"
        yield SkillFinding("budget", path, message, "shorten it", fails=False)


def _listing(agent: locations.Agent, sites: Sequence[_InstallScope]) -> SkillListing:
    lengths: dict[Path, int] = {}
    for site in sites:
        for folder in agent.folders(site.scope):
            for entry in site.entries(folder):
                try:
                    bundle = read(entry)
                except (OSError, ValueError):
                    continue
                description_length = min(len(bundle.description), agent.description_limit)
                lengths[entry.resolve()] = len(bundle.name) + description_length + _FRAME
    return SkillListing(agent.name, len(lengths), sum(lengths.values()), agent.listing)


def _over_budget(listings: Sequence[SkillListing], project: Path) -> Iterator[SkillFinding]:
    for listing in listings:
        if listing.budget is not None and listing.characters > listing.budget:
            message = (
                f"{listing.agent} finds {listing.skills} skills; its list of them has {listing.characters} characters, "
                f"and it shows about {listing.budget}: descriptions are truncated, or skills omitted"
            )
            yield SkillFinding("budget", project, message, "remove skills that you do not use", fails=False)
