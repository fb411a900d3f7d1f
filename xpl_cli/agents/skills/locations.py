"""The folders in which coding agents look for skills, and their limits on lists of skills.

Sources, as of autumn 2026: cursor.com/docs/skills, developers.openai.com/codex/skills,
code.claude.com/docs/en/skills and its settings `skillListingBudgetFraction` and `skillListingMaxDescChars`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

Scope = Literal["project", "user"]

STORE: Final = ".agents/skills"
"""The folder of the skills' files, which most agents read."""

CLAUDE: Final = ".claude/skills"
"""The only folder that Claude Code reads; it gets a link to each skill."""


@dataclass(frozen=True)
class Agent:
    """A coding agent.

    Attributes:
        name: on the command line.
        title: its product name.
        project: folders of a project that it reads, relative to its root.
        user: folders of the user that it reads, relative to their home.
        listing: longest list of all skills, characters; None if undocumented.
        description_limit: characters of a description that it shows.
    """

    name: str
    title: str
    project: tuple[str, ...]
    user: tuple[str, ...]
    listing: int | None
    description_limit: int

    def folders(self, scope: Scope) -> tuple[str, ...]:
        """Return the folders of a scope that the agent reads."""
        return self.project if scope == "project" else self.user


FOLDERS: Final = (STORE, ".cursor/skills", CLAUDE, ".codex/skills")
"""All folders that any of the agents reads."""

AGENTS: Final = (
    Agent("cursor", "Cursor", FOLDERS, FOLDERS, listing=None, description_limit=1024),
    # One percent of a window of 200,000 tokens, at four characters each.
    Agent("claude", "Claude Code", (CLAUDE,), (CLAUDE,), listing=8000, description_limit=1536),
    # Two percent of the window, or this where it is not known.
    Agent("codex", "Codex", (STORE,), (STORE, ".codex/skills"), listing=8000, description_limit=1024),
)

INSTRUCTIONS_LIMIT: Final = 32 * 1024
"""Most bytes of all AGENTS.md files together that Codex reads (`project_doc_max_bytes`)."""


def base(scope: Scope, project: Path | None) -> Path:
    """Return the base folder of a scope."""
    return Path.home() if scope == "user" else project or repository_root()


def repository_root() -> Path:
    """Return the root of the work tree that contains the working directory, where agents look; else that directory."""
    here = Path.cwd()
    return next((folder for folder in (here, *here.parents) if (folder / ".git").exists()), here)


def skills_folder(base_: Path, folder: str, scope: Scope) -> Path:
    """Return the path of a skill folder; `CLAUDE_CONFIG_DIR` moves Claude Code's user folder."""
    moved = os.environ.get("CLAUDE_CONFIG_DIR")
    if scope == "user" and folder == CLAUDE and moved:
        return Path(moved) / Path(CLAUDE).name
    return base_ / folder
