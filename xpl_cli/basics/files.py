"""Read untrusted files without blocking and up to a size limit."""

from __future__ import annotations

import errno
import os
import select
import stat
from typing import IO, TYPE_CHECKING

from xpl_cli.basics.sizes import format_size

if TYPE_CHECKING:
    from pathlib import Path

MOST_BYTES = 256 << 20
"""Far above the size of expected files, and still small enough for memory."""

_PATIENCE_S = 5.0
_LEAST = 1 << 16
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def open_regular(path: Path, most: int = MOST_BYTES) -> IO[bytes]:
    """Open a regular file for reading, without blocking; other kinds of files are refused.

    Args:
        path: the file.
        most: largest size, bytes.

    Raises:
        OSError: if it cannot be opened, is no regular file, or is too large; `strerror` fits into a sentence.
    """
    descriptor = _descriptor(path)
    stream = os.fdopen(descriptor, "rb") if is_regular(descriptor) else None
    if stream is None:
        mode = os.fstat(descriptor).st_mode
        os.close(descriptor)
        kind = next((name for matches, name in _KINDS if matches(mode)), "something else")
        raise OSError(errno.EINVAL, f"expected a file, got {kind}", str(path))
    size = os.fstat(descriptor).st_size
    if size > most:
        stream.close()
        raise OSError(
            errno.EFBIG, f"it holds {format_size(size)}, more than the limit of {format_size(most)}", str(path)
        )
    return stream


def read_regular(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file.

    Raises:
        OSError: as `open_regular`.
    """
    with open_regular(path, most) as stream:
        # Not `most`, which would be allocated at once. Files of /proc report size 0.
        return stream.read(min(most, max(os.fstat(stream.fileno()).st_size, _LEAST)))


def read_user_file(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a file that the user named: a regular one, or a pipe such as `<(command)`.

    Raises:
        OSError: as `open_regular`; or if a pipe has no writer or too much data.
    """
    descriptor = _descriptor(path)
    with os.fdopen(descriptor, "rb", buffering=0) as stream:
        if not stat.S_ISFIFO(os.fstat(descriptor).st_mode):
            return read_regular(path, most)
        read = bytearray()
        while select.select([descriptor], [], [], _PATIENCE_S)[0]:
            block = stream.read(1 << 16)
            if not block:
                return bytes(read)
            read += block
            if len(read) > most:
                raise OSError(errno.EFBIG, f"more than {format_size(most)} came out of it", str(path))
        raise OSError(errno.ETIMEDOUT, f"no data came through the pipe within {_PATIENCE_S:g} s", str(path))


def _descriptor(path: Path) -> int:
    try:
        return os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError:  # a name with NUL
        raise OSError(errno.EINVAL, "invalid file name", str(path)) from None


def is_regular(descriptor: int) -> bool:
    """Tell whether a descriptor is that of a regular file."""
    return stat.S_ISREG(os.fstat(descriptor).st_mode)
