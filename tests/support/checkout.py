"""Where things are in the checkout, and which of them belong to it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The checkout."""


def tracked(*patterns: str, root: Path = ROOT) -> list[Path]:
    """Return the files that belong to a checkout and fit one of the patterns, sorted.

    What using a checkout leaves in it (peers of benchmarks, results, adapters that were tried out, notes) is not ours
    to judge. Where there is no repository, in an unpacked source distribution, every file counts.

    Args:
        patterns: as `Path.glob` takes them, relative to the checkout: `docs/**/*.md`.
        root: the checkout.
    """
    if not (root / ".git").exists():
        found = {path for pattern in patterns for path in root.glob(pattern) if path.is_file()}
        return sorted(found)
    # The owner of a mounted checkout may be another user, whom git would not trust.
    command = ["git", "-c", "safe.directory=*", "ls-files", "-z", "--cached", "--"]
    command += [f":(glob){pattern}" for pattern in patterns]
    completed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    paths = {root / name for name in completed.stdout.split("\0") if name}
    return sorted(path for path in paths if path.is_file())  # one that was deleted, and not from the index yet


def copy(target: Path, *patterns: str, root: Path = ROOT) -> Path:
    """Copy the files that belong to a checkout and fit one of the patterns to the same places in a folder."""
    for path in tracked(*patterns, root=root):
        destination = target / path.relative_to(root)
        destination.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, destination)
    return target
