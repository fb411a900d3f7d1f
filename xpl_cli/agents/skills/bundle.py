"""A skill as a bundle of files: `SKILL.md`, whose front matter agents always see, and its references.

Source: the Agent Skills specification (agentskills.io/specification), in its state of August 2026.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import NotFoundError

FILE: Final = "SKILL.md"
REFERENCES: Final = "references"
STAMP: Final = ".xpl-skill.json"
"""File that `xpl skills install` adds to an installed bundle, to recognise it later."""

_NOT_INSTALLED: Final = frozenset({"evals", "__pycache__", STAMP, ".DS_Store"})
"""Entries of a bundle's folder that are not installed."""


class FrontMatterError(ValueError):
    """SKILL.md has no valid front matter."""


@dataclass(frozen=True)
class SkillBundle:
    """One skill.

    Attributes:
        folder: of the skill.
        front_matter: the keys of its YAML front matter.
        body: the Markdown below.
    """

    folder: Path
    front_matter: dict[str, Any]
    body: str

    @property
    def name(self) -> str:
        """Its name, which equals that of its folder."""
        return str(self.front_matter.get("name"))

    @property
    def description(self) -> str:
        """What it does and when to use it; agents see only this until they load the skill."""
        return str(self.front_matter.get("description"))

    @property
    def version(self) -> str | None:
        """The version of xpl that it belongs to."""
        metadata = self.front_matter.get("metadata")
        return str(metadata["version"]) if isinstance(metadata, dict) and "version" in metadata else None

    @property
    def references(self) -> list[Path]:
        """Its reference files, in alphabetical order."""
        return sorted((self.folder / REFERENCES).glob("*.md"))

    def text(self, *, full: bool = False) -> str:
        """Return the body; with `full`, followed by every reference below a comment with its file name."""
        more = [(path.name, path.read_text(encoding="utf-8").strip()) for path in self.references if full]
        parts = [self.body.strip(), *(f"<!-- {REFERENCES}/{name} -->\n\n{text}" for name, text in more)]
        return "\n\n".join(parts) + "\n"


def read(folder: Path) -> SkillBundle:
    """Read the skill in a folder.

    Raises:
        FrontMatterError: SKILL.md has no front matter that is a YAML mapping.
        OSError: SKILL.md cannot be read.
    """
    front_matter, body = split_front_matter((folder / FILE).read_text(encoding="utf-8"))
    return SkillBundle(folder, front_matter, body)


def split_front_matter(text: str) -> tuple[dict[str, Any], str]:
    """Split a SKILL.md into front matter and body.

    Raises:
        FrontMatterError: there is no front matter that is a YAML mapping.
    """
    import yaml

    lines = text.splitlines(keepends=True)
    if not lines or lines[0].strip() != "---":
        raise FrontMatterError(f"{FILE} must begin with a line of three hyphens")
    ends = [number for number, line in enumerate(lines) if number and line.strip() == "---"]
    if not ends:
        raise FrontMatterError(f"the front matter of {FILE} has no closing line of three hyphens")
    try:
        head = yaml.safe_load("".join(lines[1 : ends[0]]))
    except yaml.YAMLError as error:
        raise FrontMatterError(f"the front matter of {FILE} is no YAML: {' '.join(str(error).split())}") from None
    if not isinstance(head, dict):
        raise FrontMatterError(f"the front matter of {FILE} must be a mapping of keys")
    return head, "".join(lines[ends[0] + 1 :])


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a bundle that are installed, by their path relative to it."""
    files = {}
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        if path.is_file() and not _NOT_INSTALLED & set(relative.parts):
            files[relative.as_posix()] = path.read_bytes()
    return files


def bundles() -> list[SkillBundle]:
    """Return the skills of this version of xpl, in alphabetical order."""
    return [read(path.parent) for path in sorted(content_folder("skills").glob(f"*/{FILE}"))]


def select_bundles(names: list[str]) -> list[SkillBundle]:
    """Return the skills of these names; all without names.

    Raises:
        NotFoundError: a skill does not exist; with the nearest name, and all of them.
    """
    by_name = {bundle.name: bundle for bundle in bundles()}
    for name in names:
        if name not in by_name:
            from xpl_cli.standard.problems import nearest

            near = nearest(name, by_name)
            meant = f" (did you mean {near}?)" if near else ""
            raise NotFoundError(f"there is no skill {name!r}{meant}; there are: {', '.join(by_name)}")
    return [by_name[name] for name in dict.fromkeys(names)] if names else list(by_name.values())
