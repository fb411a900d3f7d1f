"""Limits on memory and processor time of a process that reads a dataset.

A small file can claim any size and cost any time: compressed blocks, link cycles, counts in a header. The kernel kills
the reading process at the limit (setrlimit(2)), whatever library it is in.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import resource
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator

_MEMORY: Final = 320 << 20
_MEMORY_OF_SIZE: Final = 3
_SECONDS: Final = 8.0
_BYTES_A_SECOND: Final = 2 << 20
_WAIT_FACTOR: Final = 12.0
_MOST_MEASURED: Final = 10_000
_MOST_LISTED: Final = 1 << 18
_BLOCK: Final = 512
"""Bytes per unit of `st_blocks` (inode(7))."""
_PAGE: Final = resource.getpagesize()


@dataclass(frozen=True)
class ReadLimits:
    """Limits of a process that reads one dataset.

    Attributes:
        memory: bytes that it may allocate beyond those of imported libraries.
        seconds: processor time per answer.
        size: of the dataset's files, bytes.
    """

    memory: int
    seconds: float
    size: int = 0

    @classmethod
    def of(cls, path: Path) -> Self:
        """Return the limits for a file or folder: a base that every dataset needs, plus a share of its size.

        Raises:
            DataError: the path is, or holds, something other than files and folders, such as a named pipe.
        """
        try:
            size = _size(path)
        except OSError as error:
            raise DataError(f"{path} cannot be read: {error.strerror}", code=ExitCode.FINDINGS) from None
        return cls(_MEMORY + _MEMORY_OF_SIZE * size, _SECONDS + size / _BYTES_A_SECOND, size)

    @property
    def wait_s(self) -> float:
        """Seconds to wait for an answer, with room for other load on the machine."""
        return _WAIT_FACTOR * self.seconds

    def apply(self) -> None:
        """Limit the memory of this process from now on, and forbid writing files and core dumps."""
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        _limit_memory(_data_memory() + self.memory)

    def start_cpu_limit(self) -> None:
        """Limit the processor time of the answer that begins now."""
        used = resource.getrusage(resource.RUSAGE_SELF)
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        end = int(used.ru_utime + used.ru_stime + self.seconds) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (end, hard))


@contextlib.contextmanager
def outside_limits(more: int = 0) -> Iterator[None]:
    """Exclude the memory that a library allocates on import from the limit.

    Args:
        more: bytes that the library allocates on first use.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if soft in (resource.RLIM_INFINITY, hard):
        yield
        return
    before = _data_memory()
    resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
    try:
        yield
    finally:
        _limit_memory(soft + max(_data_memory() - before, 0) + more)


def _limit_memory(size: int) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (size if hard == resource.RLIM_INFINITY else min(size, hard), hard))


def _data_memory() -> int:
    """Return the memory that counts for RLIMIT_DATA, private and writable, in bytes (proc_pid_statm(5))."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5]) * _PAGE


def _size(path: Path) -> int:
    """Return the bytes of a file, or of the files of a folder; a file with several links counts once.

    For a folder of more than 10,000 files the size is extrapolated from the first ones.
    """
    if not path.is_dir():
        _refuse_unless_file(path)
        return path.stat().st_size
    total = count = 0
    inodes: set[tuple[int, int]] = set()
    for entry in itertools.islice(_entries(path), _MOST_LISTED):
        count += 1
        if count <= _MOST_MEASURED:
            status = entry.stat()
            is_new = (status.st_dev, status.st_ino) not in inodes
            inodes.add((status.st_dev, status.st_ino))
            stored = status.st_blocks * _BLOCK if entry.is_symlink() else status.st_size  # sizes in /proc are arbitrary
            total += min(status.st_size, stored) * is_new
    return total * count // max(min(count, _MOST_MEASURED), 1)


def _entries(path: Path) -> Iterator[os.DirEntry[str]]:
    """Yield the files below a folder and targets of links to files; linked folders are not entered.

    Raises:
        DataError: an entry is neither file nor folder.
    """
    folders = [os.fspath(path)]
    while folders:
        with contextlib.suppress(OSError), os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
                elif _is_file(entry):
                    yield entry
                else:
                    _refuse_unless_file(Path(entry.path))


def _is_file(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_file()
    except OSError:  # a link cycle
        return False


def _refuse_unless_file(path: Path) -> None:
    """Raise `DataError` for a path that is no file, folder or broken link."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise DataError(f"{path} is neither a file nor a folder", code=ExitCode.FINDINGS)
