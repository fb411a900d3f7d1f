"""Compare files with recorded blobs without git, so that no filter or conversion runs."""

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
    """Tell whether a file has the content of a blob, also with CRLF line ends.

    Args:
        file: the file; a missing one, or anything but a file or a link, does not match.
        blob: id.
        executable: whether the blob is recorded as executable; None to ignore the mode.
        link: whether the blob is recorded as a link and holds its target.
    """
    try:
        status = file.lstat()
        if link or not stat.S_ISREG(status.st_mode):
            return link and stat.S_ISLNK(status.st_mode) and _id(os.fsencode(file.readlink()), blob) == blob
        if executable is not None and executable is not bool(status.st_mode & stat.S_IXUSR):
            return False
        return _streamed(file, status.st_size, blob) == blob or _has_other_line_ends(file, status.st_size, blob)
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
    """Tell whether a file has the content of a Git LFS pointer."""
    match = _LFS.match(pointer)
    try:
        if match is None or not file.is_file() or file.is_symlink():
            return False
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest() == match.group(1).decode()
    except OSError:
        return False


def _id(content: bytes, alike: str) -> str:
    """Return the id of a blob, by the hash function of another id."""
    state = _state(alike, len(content))
    state.update(content)
    return state.hexdigest()


def _state(alike: str, size: int) -> hashlib._Hash:
    algorithm = "sha1" if len(alike) == _SHA1 else "sha256"
    return hashlib.new(algorithm, b"blob %d\0" % size, usedforsecurity=False)
