"""Whether a skill is what the Agent Skills specification says, and whether agents take it.

Agents do not report a skill that they cannot use, or only in a log: it is simply not there. What leads to that is
marked as `dropped`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from xpl_cli.agents.skills.bundle import FILE, Bundle, HeadError, read

KEYS: Final = ("name", "description", "license", "compatibility", "metadata", "allowed-tools")
"""The keys of the specification. Agents know more, each its own; a skill for all of them uses these."""

NAME_LENGTH: Final = 64
DESCRIPTION_LENGTH: Final = 1024
COMPATIBILITY_LENGTH: Final = 500

_NAME: Final = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_LINK: Final = re.compile(r"\[[^\]]*\]\(([^)\s#]+)[^)]*\)")
_ADDRESS: Final = re.compile(r"[a-z][a-z0-9+.-]*:")


@dataclass(frozen=True)
class Problem:
    """What is wrong with a skill.

    Attributes:
        message: one sentence.
        dropped: whether an agent leaves the skill out because of it.
    """

    message: str
    dropped: bool = False


def problems(folder: Path) -> list[Problem]:
    """Return what is wrong with the skill in a folder."""
    if not folder.is_dir():
        return [Problem(f"{folder} is no folder", dropped=True)]
    if FILE not in {path.name for path in folder.iterdir()}:
        return [Problem(f"there is no {FILE}, spelt like this", dropped=True)]
    try:
        bundle = read(folder)
    except (HeadError, UnicodeDecodeError) as error:
        return [Problem(str(error), dropped=True)]
    return [*_head(bundle.head, folder.name), *_links(bundle)]


def _head(head: dict[str, Any], folder: str) -> list[Problem]:
    found = [Problem(f"unknown key {key!r}; there are: {', '.join(KEYS)}") for key in head if key not in KEYS]
    found += _name(head.get("name"), folder)
    found += _description(head.get("description"))
    compatibility = head.get("compatibility", "any")
    if not isinstance(compatibility, str) or not 0 < len(compatibility) <= COMPATIBILITY_LENGTH:
        found.append(Problem(f"compatibility must be a text of 1 to {COMPATIBILITY_LENGTH} characters"))
    texts = ("license", "allowed-tools")
    found += [Problem(f"{key} must be a text") for key in texts if not isinstance(head.get(key, ""), str)]
    metadata = head.get("metadata", {})
    if not isinstance(metadata, dict) or not all(isinstance(item, str) for pair in metadata.items() for item in pair):
        found.append(Problem("metadata must map texts to texts; put numbers into quotes"))
    return found


def _name(name: Any, folder: str) -> list[Problem]:
    if not isinstance(name, str) or not name:
        return [Problem("name is missing, or no text", dropped=True)]
    found = []
    if len(name) > NAME_LENGTH:
        found.append(Problem(f"name has {len(name)} characters, more than {NAME_LENGTH}", dropped=True))
    if not _NAME.fullmatch(name):
        told = f"name {name!r} must be small letters and digits, with single hyphens between"
        found.append(Problem(told, dropped=True))
    if name != folder:
        found.append(Problem(f"name {name!r} is not that of its folder, {folder!r}", dropped=True))
    return found


def _description(description: Any) -> list[Problem]:
    if not isinstance(description, str) or not description.strip():
        return [Problem("description is missing, or no text", dropped=True)]
    found = []
    if len(description) > DESCRIPTION_LENGTH:
        told = f"description has {len(description)} characters, more than {DESCRIPTION_LENGTH}"
        found.append(Problem(told, dropped=True))
    if "<" in description or ">" in description:
        found.append(Problem("description holds an angle bracket, which some agents refuse", dropped=True))
    return found


def _links(bundle: Bundle) -> list[Problem]:
    """Check that links lead to files of the skill, at most one folder down."""
    found = []
    for path in [bundle.folder / FILE, *bundle.references]:
        for target in _LINK.findall(path.read_text(encoding="utf-8")):
            if _ADDRESS.match(target):
                continue
            at = f"{path.relative_to(bundle.folder)} links to {target}"
            reached = (path.parent / target).resolve()
            if not reached.is_relative_to(bundle.folder.resolve()):
                found.append(Problem(f"{at}, which is not in the skill"))
            elif not reached.exists():
                found.append(Problem(f"{at}, which is not there"))
            elif len(reached.relative_to(bundle.folder.resolve()).parts) > 2:
                found.append(Problem(f"{at}, which lies deeper than one folder"))
    return found
