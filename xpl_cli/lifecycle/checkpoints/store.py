"""Where checkpoints are kept: one folder for each content, named by its digest, which appears whole or not at all.

What is on its way lies in a folder of its own, under a lock that ends with the process. It stays there after an
interruption, so that the next fetch goes on with it.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import tempfile
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.basics import user_cache
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.lifecycle.checkpoints.specification import File, check_path, digest_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_INCOMING = ".incoming"
_READ_ONLY = 0o444


@dataclass(frozen=True)
class Staging:
    """A checkpoint on its way.

    Attributes:
        whole: folder of the files that are complete.
        parts: folder of those that are not.
    """

    whole: Path
    parts: Path

    def clear(self) -> None:
        """Forget what has arrived."""
        for folder in (self.whole, self.parts):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)


@dataclass(frozen=True)
class Store:
    """A folder of checkpoints by digest.

    Attributes:
        root: the folder.
    """

    root: Path

    @classmethod
    def at(cls, folder: Path | None) -> Store:
        """Return the store in a folder, or the one in the user's cache.

        Raises:
            UserError: if it cannot be made.
        """
        store = cls.seen(folder)
        try:
            (store.root / _INCOMING).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(
                f"checkpoints cannot be kept in {store.root}: {error.strerror}",
                hint="choose another folder with --cache",
                code=ExitCode.NOT_RUN,
            ) from None
        return store

    @classmethod
    def seen(cls, folder: Path | None) -> Store:
        """Return the same store for who only looks: its folder may be missing."""
        return cls((folder or _default()).expanduser().absolute())

    def folder(self, digest: str) -> Path:
        """Return the folder of a content, there or not."""
        return self.root / digest

    def content(self, digest: str, file_name: str | None) -> Path | None:
        """Return the checkpoint of a digest: a folder, or its one file; None if it is not there."""
        path = self.folder(digest) if file_name is None else self.folder(digest) / file_name
        return path if path.exists() else None

    @contextmanager
    def staging(self, key: str, waits: Callable[[], None] = lambda: None) -> Iterator[Staging]:
        """Give the place where a checkpoint arrives, to one process at a time.

        Args:
            key: text that says which checkpoint it is.
            waits: called if another process has the place, before waiting for it.
        """
        name = hashlib.sha256(key.encode()).hexdigest()[:32]
        base = self.root / _INCOMING / name
        lock = os.open(base.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                waits()
                fcntl.flock(lock, fcntl.LOCK_EX)
            staging = Staging(base / "whole", base / "parts")
            for folder in (staging.whole, staging.parts):
                folder.mkdir(parents=True, exist_ok=True)
            yield staging
        finally:
            if not any(path.is_file() for path in base.rglob("*")):
                shutil.rmtree(base, ignore_errors=True)
            os.close(lock)

    def place(self, staging: Staging, digest: str) -> Path:
        """Put what has arrived under its digest, in one step, and return its folder."""
        for path in staging.whole.rglob("*"):
            if path.is_file():
                path.chmod(_READ_ONLY)  # no adapter writes into what others use, too
        target = self.folder(digest)
        aside = Path(tempfile.mkdtemp(dir=self.root / _INCOMING))
        try:
            with suppress(FileNotFoundError):
                target.rename(aside / "old")
            staging.whole.rename(target)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
        return target


def contents(folder: Path) -> list[File]:
    """Return the files below a folder with their sizes, sorted; what begins with a dot is no part of a checkpoint.

    Raises:
        UserError: if a folder in it is a link, which may lead anywhere, or a name cannot be written down.
    """
    found = []
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in folders:
            if (Path(place) / name).is_symlink():
                raise UserError(f"{Path(place) / name} is a link to a folder, which is not followed")
        for name in sorted(names):
            path = Path(place) / name
            if not name.startswith(".") and path.is_file():
                relative = check_path(path.relative_to(folder).as_posix(), str(folder))
                found.append(File(relative, size=path.stat().st_size))
    return found


def sha256_of(path: Path) -> str:
    """Return the digest of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def hashed(path: Path) -> tuple[str, list[File]]:
    """Return the digest of a checkpoint and its files with theirs."""
    if path.is_file():
        found = sha256_of(path)
        return found, [File(path.name, found, path.stat().st_size)]
    files = [File(file.path, sha256_of(path / file.path), file.size) for file in contents(path)]
    return digest_of(files), files


def linked(policy_dir: Path, name: str) -> Path:
    """Return the place in an adapter where the checkpoint resolver finds one by its name."""
    return policy_dir / sdk.CHECKPOINT_DIRECTORY / name


def link(policy_dir: Path, name: str, target: Path) -> Path:
    """Make `checkpoints/<name>` of an adapter a link to a checkpoint, in one step.

    Raises:
        UserError: if something else is there, or nothing can be written there.
    """
    place = linked(policy_dir, name)
    if place.exists() and not place.is_symlink():
        raise UserError(f"{place} is there already and no link: it stays, and is what ckpt_name {name!r} means")
    if place.is_symlink() and place.readlink() == target:
        return place
    try:
        place.parent.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place.parent, prefix=".") as scratch:
            fresh = Path(scratch) / name
            fresh.symlink_to(target)
            fresh.replace(place)
    except OSError as error:
        raise UserError(f"{place} cannot be written: {error.strerror}", code=ExitCode.NOT_RUN) from None
    return place


def _default() -> Path:
    return user_cache.folder() / "checkpoints"
