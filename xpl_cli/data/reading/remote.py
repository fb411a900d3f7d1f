"""A dataset whose files a separate process reads, within limits (`sets/limits.py`)."""

from __future__ import annotations

import functools
import os
import sys
import threading
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from xpl.process import link
from xpl.process.parent import Process, ProcessLostError
from xpl.registry import EntryPointError
from xpl.wire import packed
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Demonstrations, Extras, VideoClip
from xpl_cli.data.sets.limits import ReadLimits
from xpl_cli.data.sets.outlined import Outline, OutlinedEpisode

_START: Final = """
sys.path[:] = {paths!r}
from xpl_cli.data.reading.worker import main
main(int(sys.argv[2]))
"""
_MOST_ANSWER: Final = 1 << 31
_FRUGAL: Final = {
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "ARROW_IO_THREADS": "2",
    "BLOSC_NTHREADS": "2",
    "OMP_NUM_THREADS": "2",
}
"""Fewer threads and no memory pools: both reserve memory, used or not."""


def open_set(path: str | Path) -> Demonstrations:
    """Open the dataset in a file or folder. This lists episodes at most, and reads none.

    A separate process reads the files; if it exceeds its time or memory limit, it is killed and `DataError` is raised.

    Raises:
        DataError: the path does not exist, no format recognises it, or the files are damaged.
        EntryPointError: a format of an installed package cannot be used.
    """
    path = Path(path)
    if not path.exists():
        raise DataError(f"there are no demonstrations at {path}: no such file or folder", code=ExitCode.NOT_FOUND)
    return _RemoteSet(path)


class _ReaderProcess:
    """The process that reads a dataset; restarted after it died or this process forked.

    Args:
        path: of the dataset.

    Attributes:
        opened: path, format and length of the dataset.

    Raises:
        DataError: the dataset cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, threading.Lock()
        self._bounds = ReadLimits.of(path)
        self._process: Process | None = None
        self._owner = 0
        self.opened: dict[str, Any] = {}
        self._start()

    def request(self, do: str, *arguments: Any) -> Any:
        """Send a request and return the answer; its arrays are read-only.

        Raises:
            DataError: the process failed, or exceeded its limits.
        """
        with self._lock:
            if self._process is None or self._owner != os.getpid():  # a forked process must not share the link
                self._start()
            return self._request_locked(do, *arguments)

    def end_frames(self, number: int) -> None:
        """Close a frame iterator in the reader process, if that is still running."""
        with self._lock:
            if self._process is not None and self._owner == os.getpid():
                self._request_locked("end", number)

    def _start(self) -> None:
        start = _START.format(paths=[str(Path(path).resolve()) for path in sys.path if path])
        self._process = process = Process(start, environment={**os.environ, **_FRUGAL}, largest=_MOST_ANSWER)
        self._owner = os.getpid()
        weakref.finalize(self, _end, process, self._owner)
        self.opened = self._request_locked("open", str(self._path), asdict(self._bounds))

    def _request_locked(self, do: str, *arguments: Any) -> Any:
        process = self._process
        assert process is not None  # noqa: S101 - `ask` has started it
        try:
            process.send(link.encode({"do": do, "arguments": arguments}), self._bounds.wait_s)
            head, buffers = process.take()
        except ProcessLostError as error:
            self._process = None
            within = f"{self._bounds.memory >> 20} MB and {self._bounds.seconds:.0f} s of processor time"
            raise DataError(f"{self._path} cannot be read within {within}: {error}", code=ExitCode.FINDINGS) from None
        if "entry_point" in head:
            raise EntryPointError(head["entry_point"])
        if "error" in head:
            failure = head["error"]
            message = (
                failure["message"]
                if failure["code"] is not None
                else f"{self._path} cannot be read: {failure['message']}"
            )
            code = ExitCode.FINDINGS if failure["code"] is None else ExitCode(failure["code"])
            if code == ExitCode.FINDINGS and str(self._path) not in message:
                message = f"{self._path}: {message}"
            raise DataError(message, hint=failure["hint"], code=code)
        return packed.decode(buffers[0])


def _end(process: Process, owner: int) -> None:
    if os.getpid() == owner:
        process.kill()


class _RemoteSet(Demonstrations):
    """A dataset that another process reads."""

    def __init__(self, path: Path) -> None:
        self._reader = _ReaderProcess(path)
        opened = self._reader.opened
        super().__init__(opened["path"], opened["format"])
        self._length = int(opened["length"])

    @functools.cached_property
    def _about(self) -> dict[str, Any]:
        return self._reader.request("about")  # type: ignore[no-any-return]

    @property
    def rate_hz(self) -> float | None:
        """Steps per second, if the dataset has them."""
        return self._about["rate_hz"]  # type: ignore[no-any-return]

    @property
    def robot(self) -> str | None:
        """The robot's name in the dataset, if it has one."""
        return self._about["robot"]  # type: ignore[no-any-return]

    @property
    def extras(self) -> Extras:
        """Other metadata of the dataset."""
        return self._about["extras"]  # type: ignore[no-any-return]

    def __len__(self) -> int:
        """The number of episodes."""
        return self._length

    def __getitem__(self, index: int) -> _RemoteEpisode:
        """Return an episode by its index."""
        return _RemoteEpisode(self._reader, range(len(self))[index])


class _RemoteEpisode(OutlinedEpisode):
    """An episode that another process reads."""

    def __init__(self, reader: _ReaderProcess, index: int) -> None:
        self._reader, self._index = reader, index

    @functools.cached_property
    def key(self) -> str:
        """Its name in the dataset."""
        return self._reader.request("key", self._index)  # type: ignore[no-any-return]

    def outline(self) -> Outline:
        """Read everything but rows and images."""
        self.key, length, instructions, columns, cameras, extras = self._reader.request("outline", self._index)
        return Outline(
            length,
            tuple(instructions),
            {name: ColumnInfo(tuple(one["shape"]), one["dtype"], tuple(one["names"])) for name, one in columns.items()},
            {name: CameraInfo(**one) for name, one in cameras.items()},
            extras,
        )

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        info = self.columns[column]
        rows = self._reader.request("read", self._index, column, start, stop)
        return np.asarray(rows, dtype=str) if info.dtype == "str" else rows

    def video(self, camera: str) -> VideoClip | None:
        """Return a camera's video clip; None if it has none."""
        clip = self._reader.request("video", self._index, camera)
        return None if clip is None else VideoClip(**clip)

    def stats(self, camera: str) -> Mapping[str, Any] | None:
        """Return the dataset's own statistics of a camera's images; None if it has none."""
        return self._reader.request("stats", self._index, camera)  # type: ignore[no-any-return]

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Yield images of a camera."""
        if camera not in self.cameras:
            raise KeyError(camera)
        number = self._reader.request("film", self._index, camera, start, stop)
        try:
            while images := self._reader.request("frames", number):
                yield from images
        finally:
            self._reader.end_frames(number)
