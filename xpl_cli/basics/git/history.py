"""Read-only history of a git repository: merge bases, changed files, former contents.

Branches are untrusted, so none of their code runs: no filter, no hook, no external diff. Git only lists what it
recorded; changes of files are detected by reading them (`blobs.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

from xpl_cli.basics.errors import UserError
from xpl_cli.basics.git import blobs, discovery

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from xpl_cli.basics.git.command import Git

_PROGRAM: Final = "100755"
_FILE_MODES: Final = frozenset(("100644", _PROGRAM))
_LINK: Final = "120000"
_MODULE: Final = "160000"
_LEFT_OUT: Final = "S"
"""Git's mark of a file that a sparse checkout leaves out."""
_LARGEST_POINTER: Final = 1024
"""Bytes; a pointer of Git LFS has fewer."""


class _Entry(NamedTuple):
    mode: str
    blob: str


@dataclass(frozen=True)
class Repository:
    """A work tree.

    Attributes:
        git: its repository.
    """

    git: Git

    @property
    def root(self) -> Path:
        """Top of the work tree."""
        return self.git.root

    @classmethod
    def of(cls, folder: Path) -> Repository:
        """Return the work tree of the working directory.

        Raises:
            UserError: if there is none.
        """
        return cls._required(discovery.work_tree(folder), folder)

    @classmethod
    def of_package(cls, package: Path, here: Path) -> Repository:
        """Return the work tree of a package.

        Raises:
            UserError: if there is none, or it is nested inside another one (see `discovery.of_package`).
        """
        return cls._required(discovery.of_package(package, here), package)

    @classmethod
    def _required(cls, git: Git | None, folder: Path) -> Repository:
        if git is None:
            raise UserError(f"what changed needs a git repository, and {folder} lies in none")
        return cls(git)

    def base(self, ref: str) -> str:
        """Return the merge base of HEAD and a branch, tag or commit; that commit itself if there is none.

        Raises:
            UserError: if there is no such commit.
        """
        return _base(self.git, ref)

    def changed(self, base: str | None, inside: Sequence[Path] = ()) -> set[Path]:
        """Return the files that differ from a commit, including uncommitted and untracked ones.

        Args:
            base: the commit; None for an empty one.
            inside: only those in these folders.

        Returns:
            absolute paths, also of deleted files; for a repository within this one, its folder.
        """
        limits = [folder.relative_to(self.root).as_posix() for folder in inside]
        limits = [] if "." in limits else limits
        before = {} if base is None else self._recorded(base, limits)
        added, left_out = self._added(limits)
        with_modes = self._counts_modes()
        absent = {name for name in left_out if before.get(name) == added[name]}
        differing = {
            name
            for name in (before.keys() | added.keys() | self._others(limits)) - absent
            if name not in before or not self._is_same(name, before[name], added.get(name), with_modes=with_modes)
        }
        return {self.root / name for name in differing - self._lfs_unchanged(before, differing)}

    def unrecorded(self, folder: Path) -> list[str]:
        """Return the files below a folder that differ from the last commit, as paths from the top."""
        try:
            head = _commit(self.git, "HEAD")
        except UserError:  # no commit yet
            head = None
        return sorted(path.relative_to(self.root).as_posix() for path in self.changed(head, [folder]))

    def text(self, commit: str, name: str) -> str | None:
        """Return the content of a file in a commit, by its path from the top; None if it is missing."""
        try:
            return self.git.text("cat-file", "blob", f"{commit}:{name}")
        except UserError:
            return None

    def has(self, commit: str, name: str) -> bool:
        """Tell whether a commit has a file or folder, by its path from the top."""
        try:
            self.git.text("cat-file", "-e", f"{commit}:{'' if name == '.' else name}")
        except UserError:
            return False
        return True

    def export(self, commit: str, name: str, target: Path, *, largest: int) -> bool:
        """Write the files of a folder in a commit below another folder, with the same paths.

        Links and larger files are left out: callers read code.

        Args:
            commit: the commit.
            name: path of the folder from the top.
            target: folder that represents the top.
            largest: largest file, bytes.

        Returns:
            whether there were any files.
        """
        entries = [(blob, path) for blob, path, size in self._listed(commit, name) if size <= largest]
        for (_, path), content in zip(entries, self._contents([blob for blob, _ in entries]), strict=True):
            (target / path).parent.mkdir(parents=True, exist_ok=True)
            (target / path).write_bytes(content)
        return bool(entries)

    def _listed(self, commit: str, name: str) -> Iterator[tuple[str, str, int]]:
        """Yield id, path and size of the files of a folder.

        Raises:
            UserError: if a blob is missing from the repository.
        """
        inside = [] if name == "." else [f"{name}/"]
        listing = self.git.text("ls-tree", "-r", "-l", "-z", "--full-tree", commit, *inside)
        for entry in listing.split("\0"):
            head, _, path = entry.partition("\t")
            if path and head.split()[0] in _FILE_MODES:
                _, _, blob, size = head.split()
                if not size.isdecimal():  # BAD
                    raise _lacking(f"{path!r} of commit {commit:.12}")
                yield blob, path, int(size)

    def _contents(self, blobs: list[str]) -> Iterator[bytes]:
        answer = self.git.answer("cat-file", "--batch", input_bytes=_lines(blobs))
        offset = 0
        for blob in blobs:
            begin = answer.index(b"\n", offset) + 1
            _, *kind = answer[offset:begin].split()
            if kind[:1] != [b"blob"]:  # missing
                raise _lacking(f"object {blob}")
            size = int(kind[1])
            yield answer[begin : begin + size]
            offset = begin + size + 1

    def _recorded(self, commit: str, limits: list[str]) -> dict[str, _Entry]:
        """Return what a commit holds, by name."""
        listing = self.git.text("ls-tree", "-r", "-z", "--full-tree", commit, *(f"{name}/" for name in limits))
        heads = (entry.partition("\t") for entry in listing.split("\0") if entry)
        return {name: _Entry(head.split()[0], head.split()[2]) for head, _, name in heads}

    def _added(self, limits: list[str]) -> tuple[dict[str, _Entry], set[str]]:
        """Return what the next commit would hold, by name, and which of it a sparse checkout leaves out."""
        listing = self.git.text("ls-files", "-z", "-t", "--stage", "--full-name", "--", *limits)
        found, left_out = {}, set()
        for entry in listing.split("\0"):
            head, _, name = entry.partition("\t")
            if name:
                tag, mode, blob, _ = head.split()
                found[name] = _Entry(mode, blob)
                left_out |= {name} if tag == _LEFT_OUT else set()
        return found, left_out

    def _others(self, limits: list[str]) -> set[str]:
        """Return the untracked files that are not ignored."""
        listing = self.git.text("ls-files", "-z", "--others", "--exclude-standard", "--full-name", "--", *limits)
        return {name for name in listing.split("\0") if name}

    def _is_same(self, name: str, before: _Entry, added: _Entry | None, *, with_modes: bool) -> bool:
        if _MODULE in {before.mode, added.mode if added else ""}:
            return before == added
        executable = before.mode == _PROGRAM if with_modes and before.mode in _FILE_MODES else None
        return blobs.matches_blob(self.root / name, before.blob, executable=executable, link=before.mode == _LINK)

    def _counts_modes(self) -> bool:
        return self.git.text("config", "--type=bool", "--default=true", "core.fileMode").strip() == "true"

    def _lfs_unchanged(self, before: dict[str, _Entry], names: Iterable[str]) -> set[str]:
        """Return the files whose content git keeps elsewhere, by Git LFS, and that still hold it."""
        asked = {name: before[name].blob for name in names if name in before and before[name].mode in _FILE_MODES}
        try:
            told = self.git.answer(
                "cat-file", "--batch-check=%(objecttype) %(objectsize)", input_bytes=_lines(asked.values())
            )
            sizes = [line.split() for line in told.decode(errors="replace").splitlines()]
            small = {
                name: blob
                for (name, blob), size in zip(asked.items(), sizes, strict=True)
                if size[0] == "blob" and int(size[1]) <= _LARGEST_POINTER
            }
            pointers = list(self._contents(list(small.values())))
        except UserError:  # objects that a partial clone lacks
            return set()
        held = zip(small, pointers, strict=True)
        return {name for name, pointer in held if blobs.matches_lfs_pointer(self.root / name, pointer)}


def _lacking(what: str) -> UserError:
    return UserError(f"the repository lacks the content of {what}", hint="fetch it; git fsck tells what else is gone")


def _lines(blobs: Iterable[str]) -> bytes:
    return "".join(f"{blob}\n" for blob in blobs).encode()


@cache
def _base(git: Git, ref: str) -> str:
    try:
        commit = _commit(git, ref)
    except UserError:
        raise UserError(f"{git.root} has no commit {ref!r}", hint=f"git fetch origin {ref}, or name another") from None
    try:
        return git.text("merge-base", commit, "HEAD").strip()
    except UserError:  # a shallow clone, or histories without a common beginning
        return commit


def _commit(git: Git, ref: str) -> str:
    return git.text("rev-parse", "--verify", "--quiet", "--end-of-options", f"{ref}^{{commit}}").strip()


def unrecorded(folder: Path) -> list[str]:
    """Return the files below a folder that version control has not recorded; none where there is no git."""
    git = discovery.work_tree(folder)
    try:
        return [] if git is None else Repository(git).unrecorded(folder.resolve())
    except UserError:
        return []
