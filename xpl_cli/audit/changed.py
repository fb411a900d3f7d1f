"""Which packages changed since a commit, judged by the files that an audit reads."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.audit.source import Source
from xpl_cli.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl_cli.audit.targets import Target


def select_changed(ref: str, targets: Iterable[Target]) -> list[Target]:
    """Return the packages with a boundary file that differs from where the working tree left a commit's history.

    That is the merge base of the commit and HEAD: what others changed there meanwhile does not count. Files that are
    not committed, or not even added, do. Of files that are gone nobody can say whether they were read: each counts.

    Args:
        ref: a branch, tag or commit.
        targets: packages.

    Raises:
        UserError: if a package lies in no git repository, if there is no such commit there, or no git.
    """
    return [target for target in targets if _is_changed(ref, target)]


def _is_changed(ref: str, target: Target) -> bool:
    root = _root(target.path)
    names = _names(root, _base(root, ref), target.path)
    present = {name for name in names if (target.path / name).is_file()}
    return bool(names - present) or bool(present.intersection(Source(target.path).files))


def _names(root: Path, base: str, package: Path) -> set[str]:
    """Return the files of a package that were changed, added or removed, relative to it."""
    inside = package.relative_to(root).as_posix()
    told = _git(root, "diff", "--name-only", "-z", "--no-renames", "--no-ext-diff", base, "--", f":(literal){inside}")
    told += _git(root, "ls-files", "-z", "--others", "--exclude-standard", "--", f":(literal){inside}")
    paths = (root / name for name in told.split("\0") if name)
    return {path.relative_to(package).as_posix() for path in paths}


@cache
def _root(folder: Path) -> Path:
    try:
        return Path(_git(folder, "rev-parse", "--show-toplevel").removesuffix("\n")).resolve()
    except UserError as error:
        raise UserError(f"--changed-since needs a git repository, and {folder} lies in none: {error}") from None


@cache
def _base(root: Path, ref: str) -> str:
    """Return the commit to compare with."""
    try:
        commit = _git(root, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{ref}^{{commit}}").strip()
    except UserError:
        raise UserError(
            f"--changed-since: {root} has no commit {ref!r}", hint=f"git fetch origin {ref}, or name another"
        ) from None
    try:
        return _git(root, "merge-base", commit, "HEAD").strip()
    except UserError:  # a shallow clone, or histories without a common beginning
        return commit


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, check=False, stdin=subprocess.DEVNULL)
    except FileNotFoundError:
        raise UserError("--changed-since needs git, which is not on PATH") from None
    if done.returncode:
        raise UserError(done.stderr.decode(errors="replace").strip() or f"git ended with {done.returncode}")
    return done.stdout.decode(errors="surrogateescape")
