"""A git repository, read: where a branch began, what changed since, what files held. Nothing is written.

Other people's branches are looked at, so nothing that they hold is run: no filter, no hook, no external diff.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Iterator

_FILE_MODES = frozenset(("100644", "100755"))


@dataclass(frozen=True)
class Repository:
    """A work tree.

    Attributes:
        root: its top.
    """

    root: Path

    @classmethod
    def of(cls, folder: Path) -> Repository:
        """Return the work tree that a folder lies in.

        Raises:
            UserError: if it lies in none, or there is no git.
        """
        return cls(_root(folder))

    def base(self, ref: str) -> str:
        """Return the commit where HEAD and a branch, tag or commit parted; that commit itself if nobody can tell.

        Raises:
            UserError: if there is no such commit.
        """
        return _base(self.root, ref)

    def changed(self, base: str, inside: Path | None = None) -> set[Path]:
        """Return the files that differ from a commit, those not committed or not even added included.

        Args:
            base: the commit.
            inside: only those in this folder.

        Returns:
            absolute paths; of files that are gone, too.
        """
        limits = [] if inside is None else ["--", f":(literal){inside.relative_to(self.root).as_posix()}"]
        told = _git(self.root, "diff", "--name-only", "-z", "--no-renames", "--no-ext-diff", base, *limits)
        told += _git(self.root, "ls-files", "-z", "--others", "--exclude-standard", *limits)
        return {self.root / name for name in told.split("\0") if name}

    def text(self, commit: str, name: str) -> str | None:
        """Return what a file, named from the top, held in a commit; None if it was not there."""
        try:
            return _git(self.root, "cat-file", "blob", f"{commit}:{name}")
        except UserError:
            return None

    def has(self, commit: str, name: str) -> bool:
        """Tell whether a commit has a file or folder, named from the top."""
        try:
            _git(self.root, "cat-file", "-e", f"{commit}:{'' if name == '.' else name}")
        except UserError:
            return False
        return True

    def export(self, commit: str, name: str, target: Path, *, largest: int) -> bool:
        """Write the files that a folder had in a commit below another folder, under the same names.

        Links are left out, and so are files that are larger: what asks for this reads code.

        Args:
            commit: the commit.
            name: the folder, from the top.
            target: folder that stands for the top.
            largest: bytes.

        Returns:
            whether there were any.
        """
        entries = [(blob, path) for blob, path, size in self._listed(commit, name) if size <= largest]
        for (_, path), content in zip(entries, self._contents([blob for blob, _ in entries]), strict=True):
            (target / path).parent.mkdir(parents=True, exist_ok=True)
            (target / path).write_bytes(content)
        return bool(entries)

    def _listed(self, commit: str, name: str) -> Iterator[tuple[str, str, int]]:
        """Yield id, path and size of the files of a folder."""
        inside = [] if name == "." else [f"{name}/"]
        told = _git(self.root, "--literal-pathspecs", "ls-tree", "-r", "-l", "-z", "--full-tree", commit, *inside)
        for entry in told.split("\0"):
            head, _, path = entry.partition("\t")
            if path and head.split()[0] in _FILE_MODES:
                yield head.split()[2], path, int(head.split()[3])

    def _contents(self, blobs: list[str]) -> Iterator[bytes]:
        answer = _bytes(self.root, "cat-file", "--batch", asked="".join(f"{blob}\n" for blob in blobs).encode())
        place = 0
        for _ in blobs:
            begin = answer.index(b"\n", place) + 1
            size = int(answer[place:begin].split()[2])
            yield answer[begin : begin + size]
            place = begin + size + 1


@cache
def _root(folder: Path) -> Path:
    try:
        return Path(_git(folder, "rev-parse", "--show-toplevel").removesuffix("\n")).resolve()
    except UserError as error:
        raise UserError(f"what changed needs a git repository, and {folder} lies in none: {error}") from None


@cache
def _base(root: Path, ref: str) -> str:
    try:
        commit = _git(root, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{ref}^{{commit}}").strip()
    except UserError:
        raise UserError(f"{root} has no commit {ref!r}", hint=f"git fetch origin {ref}, or name another") from None
    try:
        return _git(root, "merge-base", commit, "HEAD").strip()
    except UserError:  # a shallow clone, or histories without a common beginning
        return commit


def _git(folder: Path, *arguments: str) -> str:
    return _bytes(folder, *arguments).decode(errors="surrogateescape")


def _bytes(folder: Path, *arguments: str, asked: bytes = b"") -> bytes:
    """Return what a git command answers to what it is asked on its standard input."""
    command = ["git", "-C", str(folder), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, check=False, input=asked)
    except FileNotFoundError:
        raise UserError("what changed needs git, which is not on PATH") from None
    if done.returncode:
        raise UserError(done.stderr.decode(errors="replace").strip() or f"git ended with {done.returncode}")
    return done.stdout
