"""Validation of skills against the Agent Skills specification.

Agents do not report a skill that they cannot use, or only in a log. Problems that make an agent ignore a skill are
marked as `dropped`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from xpl_cli.agents.skills.bundle import FILE, FrontMatterError, SkillBundle, read

KEYS: Final = ("name", "description", "license", "compatibility", "metadata", "allowed-tools")
"""The keys of the specification. Agents have further keys of their own; a skill for all agents uses only these."""

NAME_LENGTH: Final = 64
DESCRIPTION_LENGTH: Final = 1024
COMPATIBILITY_LENGTH: Final = 500

_NAME: Final = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_LINK: Final = re.compile(r"\[[^\]]*\]\(([^)\s#]+)[^)]*\)")
_ADDRESS: Final = re.compile(r"[a-z][a-z0-9+.-]*:")


@dataclass(frozen=True)
class SkillProblem:
    """A problem of a skill.

    Attributes:
        message: one sentence.
        dropped: whether agents ignore the skill because of it.
    """

    message: str
    dropped: bool = False


def problems(folder: Path) -> list[SkillProblem]:
    """Return the problems of the skill in a folder."""
    if not folder.is_dir():
        return [SkillProblem(f"{folder} is no folder", dropped=True)]
    if FILE not in {path.name for path in folder.iterdir()}:
        return [SkillProblem(f"there is no {FILE} (in this spelling)", dropped=True)]
    try:
        bundle = read(folder)
    except (FrontMatterError, UnicodeDecodeError) as error:
        return [SkillProblem(str(error), dropped=True)]
    return [*_front_matter_problems(bundle.front_matter, folder.name), *_link_problems(bundle)]


def _front_matter_problems(head: dict[str, Any], folder: str) -> list[SkillProblem]:
    result = [SkillProblem(f"unknown key {key!r}; there are: {', '.join(KEYS)}") for key in head if key not in KEYS]
    result += _name_problems(head.get("name"), folder)
    result += _description_problems(head.get("description"))
    compatibility = head.get("compatibility", "any")
    if not isinstance(compatibility, str) or not 0 < len(compatibility) <= COMPATIBILITY_LENGTH:
        result.append(SkillProblem(f"compatibility must be a string of 1 to {COMPATIBILITY_LENGTH} characters"))
    texts = ("license", "allowed-tools")
    result += [SkillProblem(f"{key} must be a string") for key in texts if not isinstance(head.get(key, ""), str)]
    metadata = head.get("metadata", {})
    if not isinstance(metadata, dict) or not all(isinstance(item, str) for pair in metadata.items() for item in pair):
        result.append(SkillProblem("metadata must map strings to strings; quote numbers"))
    return result


def _name_problems(name: Any, folder: str) -> list[SkillProblem]:
    if not isinstance(name, str) or not name:
        return [SkillProblem("name is missing, or no string", dropped=True)]
    result = []
    if len(name) > NAME_LENGTH:
        result.append(SkillProblem(f"name has {len(name)} characters, more than {NAME_LENGTH}", dropped=True))
    if not _NAME.fullmatch(name):
        message = f"name {name!r} must be lower-case letters and digits, separated by single hyphens"
        result.append(SkillProblem(message, dropped=True))
    if name != folder:
        result.append(SkillProblem(f"name {name!r} differs from that of its folder, {folder!r}", dropped=True))
    return result


def _description_problems(description: Any) -> list[SkillProblem]:
    if not isinstance(description, str) or not description.strip():
        return [SkillProblem("description is missing, or no string", dropped=True)]
    result = []
    if len(description) > DESCRIPTION_LENGTH:
        message = f"description has {len(description)} characters, more than {DESCRIPTION_LENGTH}"
        result.append(SkillProblem(message, dropped=True))
    if "<" in description or ">" in description:
        result.append(SkillProblem("description has an angle bracket, which some agents reject", dropped=True))
    return result


def _link_problems(bundle: SkillBundle) -> list[SkillProblem]:
    """Check that links lead to files of the skill, at most one folder deep."""
    result = []
    for path in [bundle.folder / FILE, *bundle.references]:
        for target in _LINK.findall(path.read_text(encoding="utf-8")):
            if _ADDRESS.match(target):
                continue
            at = f"{path.relative_to(bundle.folder)} links to {target}"
            reached = (path.parent / target).resolve()
            if not reached.is_relative_to(bundle.folder.resolve()):
                result.append(SkillProblem(f"{at}, which is outside the skill"))
            elif not reached.exists():
                result.append(SkillProblem(f"{at}, which does not exist"))
            elif len(reached.relative_to(bundle.folder.resolve()).parts) > 2:
                result.append(SkillProblem(f"{at}, which is more than one folder deep"))
    return result
