"""Atomic writes of files and folders."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


def write_file(path: Path, content: bytes, mode: int = 0o644) -> None:
    """Write a file; readers see the old content or the new one, never a part."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    partial = Path(name)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        partial.chmod(mode)  # mkstemp creates private files
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


@contextmanager
def replaced_folder(target: Path) -> Iterator[Path]:
    """Yield an empty folder, which replaces `target` when the block ends without an exception.

    It lies beside `target`, because an atomic rename needs the same file system. Missing parents are created, and
    removed again if the block fails.
    """
    made = _make_parents(target.parent)
    staging = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name[:64]}."))
    try:
        staging.chmod(0o777 & ~_umask())  # mkdtemp creates private folders
        yield staging
        _put(staging, target)
        made.clear()
    finally:
        # After an exchange this is what `target` held before.
        shutil.rmtree(staging, ignore_errors=True)
        for parent in made:
            with suppress(OSError):  # another process uses it by now
                parent.rmdir()


def keep(source: Path, destination: Path) -> None:
    """Make `destination` the same file, link or tree as `source` without copying what files hold.

    Files are hard links, so that a folder of checkpoints costs nothing; both names are whole files at any time.

    Raises:
        OSError: EXDEV if the tree reaches into another file system.
    """
    if source.is_symlink() or not source.is_dir():
        _link(source, destination)
        return
    destination.mkdir()
    for entry in source.iterdir():
        keep(entry, destination / entry.name)
    shutil.copystat(source, destination)


def _link(source: Path, destination: Path) -> None:
    try:
        os.link(source, destination, follow_symlinks=False)
    except OSError as error:
        # Not every file system has hard links, and not every user may link every file.
        if error.errno not in (errno.EPERM, errno.EACCES, errno.EMLINK, errno.ENOTSUP):
            raise
        shutil.copy2(source, destination, follow_symlinks=False)


def _make_parents(folder: Path) -> list[Path]:
    """Create the folder and its parents; return the created ones, innermost first."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return missing


def _put(staging: Path, target: Path) -> None:
    """Rename `staging` to `target`; what `target` held before is then at `staging`, or nowhere if it was nothing."""
    if not target.exists():
        staging.rename(target)
        return
    if _exchange(staging, target):
        return
    # No atomic exchange here: two renames, the first is undone if the second fails.
    aside = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name[:64]}.")) / target.name
    try:
        target.rename(aside)
        try:
            staging.rename(target)
        except BaseException:
            aside.rename(target)
            raise
    finally:
        shutil.rmtree(aside.parent, ignore_errors=True)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two paths atomically; False where the system or the file system cannot."""
    if not sys.platform.startswith("linux"):
        return False
    import ctypes

    try:
        rename = ctypes.CDLL(None).renameat2
    except AttributeError:
        return False
    status: int = rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE)
    return status == 0


def _umask() -> int:
    current = os.umask(0o022)
    os.umask(current)
    return current
