"""Files that others wrote, read without waiting for anybody and never beyond a bound."""

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
"""What no file that people or tools write for us comes near, and what a machine can still hold in memory."""

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
    """Open a regular file for reading; whatever else the path leads to is refused, and nothing waits for a writer.

    Args:
        path: the file.
        most: bytes that it may hold.

    Raises:
        OSError: it cannot be opened, is no regular file, or is too large; `strerror` is fit for a sentence.
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
    """Return what a regular file holds.

    Raises:
        OSError: as `opened`.
    """
    with open_regular(path, most) as stream:
        # Not `most`, which would be taken at once however small the file is. Those of /proc say that they are empty.
        return stream.read(min(most, max(os.fstat(stream.fileno()).st_size, _LEAST)))


def read_user_file(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return what a file holds that the user named: a regular one, or a pipe, as `<(command)` makes them.

    Raises:
        OSError: as `opened`; or nobody writes to the pipe, or too much.
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
        raise OSError(errno.ETIMEDOUT, f"nobody wrote to the pipe within {_PATIENCE_S:g} s", str(path))


def _descriptor(path: Path) -> int:
    try:
        return os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError:  # a name that holds NUL
        raise OSError(errno.EINVAL, "no file can have that name", str(path)) from None


def is_regular(descriptor: int) -> bool:
    """Tell whether what was opened is a regular file."""
    return stat.S_ISREG(os.fstat(descriptor).st_mode)
