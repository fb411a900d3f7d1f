"""A skill as a bundle of files: `SKILL.md`, whose head agents always see, and the references that it points to.

Source of the form: the Agent Skills specification (agentskills.io/specification), in its state of August 2026.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from xpl_cli.basics.content import room
from xpl_cli.basics.errors import NotFoundError

FILE: Final = "SKILL.md"
REFERENCES: Final = "references"
STAMP: Final = ".xpl-skill.json"
"""What `xpl skills install` writes beside a bundle, to know it again."""

_NOT_INSTALLED: Final = frozenset({"evals", "__pycache__", STAMP, ".DS_Store"})
"""Entries of a bundle's folder that are no part of what an agent reads."""


class HeadError(ValueError):
    """SKILL.md does not begin with a head that can be read."""


@dataclass(frozen=True)
class Bundle:
    """One skill.

    Attributes:
        folder: where it lies.
        head: the keys of its YAML head.
        body: the Markdown below.
    """

    folder: Path
    head: dict[str, Any]
    body: str

    @property
    def name(self) -> str:
        """Its name, which is that of its folder."""
        return str(self.head.get("name"))

    @property
    def description(self) -> str:
        """What it does and when to use it: all that agents see until they load it."""
        return str(self.head.get("description"))

    @property
    def version(self) -> str | None:
        """Version of `xpl` that it belongs to."""
        metadata = self.head.get("metadata")
        return str(metadata["version"]) if isinstance(metadata, dict) and "version" in metadata else None

    @property
    def references(self) -> list[Path]:
        """Its reference files, in alphabetical order."""
        return sorted((self.folder / REFERENCES).glob("*.md"))

    def text(self, *, full: bool = False) -> str:
        """Return the body, and with `full` every reference below a line that names its file."""
        more = [(path.name, path.read_text(encoding="utf-8").strip()) for path in self.references if full]
        parts = [self.body.strip(), *(f"<!-- {REFERENCES}/{name} -->\n\n{text}" for name, text in more)]
        return "\n\n".join(parts) + "\n"


def read(folder: Path) -> Bundle:
    """Return the skill in a folder.

    Raises:
        HeadError: if its SKILL.md has no head, or none that is a YAML mapping.
        OSError: if SKILL.md cannot be read.
    """
    head, body = split((folder / FILE).read_text(encoding="utf-8"))
    return Bundle(folder, head, body)


def split(text: str) -> tuple[dict[str, Any], str]:
    """Return the head and the body of a SKILL.md.

    Raises:
        HeadError: if there is no head, or none that is a YAML mapping.
    """
    import yaml

    lines = text.splitlines(keepends=True)
    if not lines or lines[0].strip() != "---":
        raise HeadError(f"{FILE} must begin with a line of three hyphens")
    ends = [number for number, line in enumerate(lines) if number and line.strip() == "---"]
    if not ends:
        raise HeadError(f"the head of {FILE} has no closing line of three hyphens")
    try:
        head = yaml.safe_load("".join(lines[1 : ends[0]]))
    except yaml.YAMLError as error:
        raise HeadError(f"the head of {FILE} is no YAML: {' '.join(str(error).split())}") from None
    if not isinstance(head, dict):
        raise HeadError(f"the head of {FILE} must be a mapping of keys")
    return head, "".join(lines[ends[0] + 1 :])


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a bundle as an agent reads them, by their path with `/` between folders."""
    found = {}
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        if path.is_file() and not _NOT_INSTALLED & set(relative.parts):
            found[relative.as_posix()] = path.read_bytes()
    return found


def bundles() -> list[Bundle]:
    """Return the skills that belong to this version of `xpl`, in alphabetical order."""
    return [read(path.parent) for path in sorted(room("skills").glob(f"*/{FILE}"))]


def chosen(names: list[str]) -> list[Bundle]:
    """Return the skills of these names, or all.

    Raises:
        NotFoundError: if there is no such skill; with the nearest name, and all of them.
    """
    known = {bundle.name: bundle for bundle in bundles()}
    for name in names:
        if name not in known:
            from xpl_cli.standard.problems import nearest

            near = nearest(name, known)
            meant = f" (did you mean {near}?)" if near else ""
            raise NotFoundError(f"there is no skill {name!r}{meant}; there are: {', '.join(known)}")
    return [known[name] for name in dict.fromkeys(names)] if names else list(known.values())
