"""What version control has not recorded of a folder."""

from __future__ import annotations

import shutil
import subprocess
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_STATUS_WIDTH = 3


def unrecorded(folder: Path) -> list[str]:
    """Return the files below a folder that git knows otherwise or not at all; none outside of a repository."""
    git = shutil.which("git")
    if git is None:
        return []
    command = [
        git,
        "-C",
        str(folder),
        "status",
        "--porcelain",
        "-z",
        "--untracked-files=all",
        "--no-renames",
        "--",
        ".",
    ]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode:
        return []
    entries = done.stdout.decode(errors="replace").split("\0")
    return [entry[_STATUS_WIDTH:] for entry in entries if entry]
