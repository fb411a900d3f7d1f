"""Where coding agents look for skills, and how much of them they show.

Sources, in their state of autumn 2026: cursor.com/docs/skills, developers.openai.com/codex/skills,
code.claude.com/docs/en/skills and its settings `skillListingBudgetFraction` and `skillListingMaxDescChars`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

Scope = Literal["project", "user"]

STORE: Final = ".agents/skills"
"""Where skills lie as files: the folder that most agents read."""

CLAUDE: Final = ".claude/skills"
"""The only folder that Claude Code reads; it gets a link for each skill."""


@dataclass(frozen=True)
class Agent:
    """A coding agent.

    Attributes:
        name: what the command line calls it.
        title: what it calls itself.
        project: folders of a project that it reads, relative to its top.
        user: folders of the user that it reads, relative to their home.
        listing: characters that its list of all skills may have, or None if it does not say.
        shown: characters that it shows of one description.
    """

    name: str
    title: str
    project: tuple[str, ...]
    user: tuple[str, ...]
    listing: int | None
    shown: int

    def folders(self, scope: Scope) -> tuple[str, ...]:
        """Return the folders of a scope that it reads."""
        return self.project if scope == "project" else self.user


FOLDERS: Final = (STORE, ".cursor/skills", CLAUDE, ".codex/skills")
"""All folders that any of the agents reads."""

AGENTS: Final = (
    Agent("cursor", "Cursor", FOLDERS, FOLDERS, listing=None, shown=1024),
    # One percent of a window of 200,000 tokens, at four characters each.
    Agent("claude", "Claude Code", (CLAUDE,), (CLAUDE,), listing=8000, shown=1536),
    # Two percent of the window, or this where it is not known.
    Agent("codex", "Codex", (STORE,), (STORE, ".codex/skills"), listing=8000, shown=1024),
)

INSTRUCTIONS_LIMIT: Final = 32 * 1024
"""Bytes of all AGENTS.md together that Codex reads (`project_doc_max_bytes`)."""


def base(scope: Scope, project: Path | None) -> Path:
    """Return the folder that places of a scope start at."""
    return Path.home() if scope == "user" else project or top()


def top() -> Path:
    """Return the top of the work tree that the working directory lies in, which is where agents look; or itself."""
    here = Path.cwd()
    return next((folder for folder in (here, *here.parents) if (folder / ".git").exists()), here)


def place(base_: Path, folder: str, scope: Scope) -> Path:
    """Return where a folder of skills is; Claude Code's own variable moves its folder of the user."""
    moved = os.environ.get("CLAUDE_CONFIG_DIR")
    if scope == "user" and folder == CLAUDE and moved:
        return Path(moved) / Path(CLAUDE).name
    return base_ / folder
