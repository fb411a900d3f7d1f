"""What reading a set may take: memory and processor time, by its size.

A small file can claim any size and cost any time: compressed blocks, links in circles, counts in a header. The process
that reads it is ended there (setrlimit(2)), whatever library it is in.
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
"""Bytes of what `st_blocks` counts (inode(7))."""
_PAGE: Final = resource.getpagesize()


@dataclass(frozen=True)
class ReadLimits:
    """Of a process that reads one set.

    Attributes:
        memory: bytes that it may take beyond what its libraries have taken when they were imported.
        seconds: of processor time for one answer.
        size: bytes of the set's files.
    """

    memory: int
    seconds: float
    size: int = 0

    @classmethod
    def of(cls, path: Path) -> Self:
        """Return the bounds for a file or folder: what any needs, and more for a large one.

        Raises:
            DataError: it is, or holds, something else than files and folders, such as a pipe that waits for a writer.
        """
        try:
            size = _size(path)
        except OSError as error:
            raise DataError(f"{path} cannot be read: {error.strerror}", code=ExitCode.FINDINGS) from None
        return cls(_MEMORY + _MEMORY_OF_SIZE * size, _SECONDS + size / _BYTES_A_SECOND, size)

    @property
    def wait_s(self) -> float:
        """Seconds to wait for an answer, on a machine that has other work too."""
        return _WAIT_FACTOR * self.seconds

    def apply(self) -> None:
        """Hold this process to the memory from here on; it writes no file and leaves no core either."""
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        _limit_memory(_data_memory() + self.memory)

    def start_cpu_limit(self) -> None:
        """Count the processor time of one answer from here on."""
        used = resource.getrusage(resource.RUSAGE_SELF)
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        end = int(used.ru_utime + used.ru_stime + self.seconds) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (end, hard))


@contextlib.contextmanager
def outside_limits(more: int = 0) -> Iterator[None]:
    """Leave what a library takes when it is imported out of the bounds.

    Args:
        more: bytes that it takes for itself when it is first used.
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
    """Return what counts for RLIMIT_DATA: private memory that can be written to, bytes (proc_pid_statm(5))."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5]) * _PAGE


def _size(path: Path) -> int:
    """Return the bytes of a file, or of the files of a folder: each once, however many links lead to it.

    Of a folder of very many files it is by the first ones and their number.
    """
    if not path.is_dir():
        _refuse_unless_file(path)
        return path.stat().st_size
    total = count = 0
    seen: set[tuple[int, int]] = set()
    for entry in itertools.islice(_entries(path), _MOST_LISTED):
        count += 1
        if count <= _MOST_MEASURED:
            status = entry.stat()
            is_new = (status.st_dev, status.st_ino) not in seen
            seen.add((status.st_dev, status.st_ino))
            stored = status.st_blocks * _BLOCK if entry.is_symlink() else status.st_size  # /proc has any sizes
            total += min(status.st_size, stored) * is_new
    return total * count // max(min(count, _MOST_MEASURED), 1)


def _entries(path: Path) -> Iterator[os.DirEntry[str]]:
    """Yield the files below a folder, also those that links lead to, but not what is below linked folders.

    Raises:
        DataError: something is neither.
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
    except OSError:  # links in a circle
        return False


def _refuse_unless_file(path: Path) -> None:
    """Refuse what is no file, folder or broken link."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise DataError(f"{path} is neither file nor folder; a set has only these", code=ExitCode.FINDINGS)
