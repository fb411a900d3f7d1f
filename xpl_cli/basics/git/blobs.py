"""Whether a file still holds what git recorded of it, found out without git: no filter and no conversion runs."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path

_SHA1: Final = 40
_PIECE: Final = 1 << 20
_MOST_TEXT: Final = 8 << 20
_LFS: Final = re.compile(rb"version https://git-lfs\.github\.com/spec/v1\n.*?oid sha256:([0-9a-f]{64})\n", re.DOTALL)


def matches_blob(file: Path, blob: str, *, executable: bool | None, link: bool) -> bool:
    """Tell whether a file holds the bytes of a blob, or their lines with the line ends of DOS.

    Args:
        file: the file; gone, or anything but a file or a link, it is not the same.
        blob: id.
        executable: whether the blob is recorded as a program; None if that does not count.
        link: whether the blob is recorded as a link, and holds where it leads.
    """
    try:
        found = file.lstat()
        if link or not stat.S_ISREG(found.st_mode):
            return link and stat.S_ISLNK(found.st_mode) and _id(os.fsencode(file.readlink()), blob) == blob
        if executable is not None and executable is not bool(found.st_mode & stat.S_IXUSR):
            return False
        return _streamed(file, found.st_size, blob) == blob or _has_other_line_ends(file, found.st_size, blob)
    except OSError:
        return False


def _streamed(file: Path, size: int, alike: str) -> str:
    state = _state(alike, size)
    with file.open("rb") as stream:
        while piece := stream.read(_PIECE):
            state.update(piece)
    return state.hexdigest()


def _has_other_line_ends(file: Path, size: int, blob: str) -> bool:
    content = file.read_bytes() if size <= _MOST_TEXT else b""
    return b"\r\n" in content and _id(content.replace(b"\r\n", b"\n"), blob) == blob


def matches_lfs_pointer(file: Path, pointer: bytes) -> bool:
    """Tell whether a file holds what a pointer of Git LFS stands for."""
    found = _LFS.match(pointer)
    try:
        if found is None or not file.is_file() or file.is_symlink():
            return False
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest() == found.group(1).decode()
    except OSError:
        return False


def _id(content: bytes, alike: str) -> str:
    """Return the id of a blob, by the hash that another id was made with."""
    state = _state(alike, len(content))
    state.update(content)
    return state.hexdigest()


def _state(alike: str, size: int) -> hashlib._Hash:
    algorithm = "sha1" if len(alike) == _SHA1 else "sha256"
    return hashlib.new(algorithm, b"blob %d\0" % size, usedforsecurity=False)
