"""The reader process: opens a dataset with the reader of its format, and answers the requests of `remote.py`."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

import numpy as np

from xpl.process import child
from xpl.registry import EntryPointError
from xpl.wire import packed
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.data.formats.detection import open_here
from xpl_cli.data.sets.claims import SizeClaims
from xpl_cli.data.sets.errors import LibraryMissingError
from xpl_cli.data.sets.limits import ReadLimits

if TYPE_CHECKING:
    from xpl.process.link import Head
    from xpl.wire.arrays import Data
    from xpl_cli.data.sets.interface import Demonstrations

_FRAMES_BYTES: Final = 8 << 20
"""Most bytes of images per answer; an answer has one image at least."""


def main(descriptor: int) -> NoReturn:
    """Answer requests until the parent closes the link."""
    child.serve(descriptor, _ReaderService().handle)


class _ReaderService:
    """One dataset, and its open frame iterators."""

    def __init__(self) -> None:
        self._bounds = ReadLimits(0, 0.0)
        self._claims = SizeClaims("", 0)
        self._set: Demonstrations | None = None
        self._numbers = itertools.count()
        self._films: dict[int, Iterator[np.ndarray]] = {}

    def handle(self, head: Head, _buffers: Sequence[memoryview]) -> tuple[Head, list[Data]]:
        """Return the answer to a request: a packed value, or an error."""
        try:
            if head["do"] != "open":
                self._bounds.start_cpu_limit()
            return {}, [self._answer(head["do"], head["arguments"])]
        except Exception as error:  # noqa: BLE001 - libraries raise almost anything on damaged files
            return self._failure(error), []

    def _answer(self, do: str, arguments: Sequence[Any]) -> bytes:
        data = b"".join(packed.encode(getattr(self, f"_{do}")(*arguments)))
        if do == "outline":
            self._claims.add_metadata(arguments[0], len(data))
        return data

    def _failure(self, error: Exception) -> Head:
        """Return the head of an error answer."""
        if isinstance(error, EntryPointError):
            return {"entry_point": str(error)}
        if isinstance(error, UserError):
            # Readers raise NOT_RUN; here the cause is a damaged dataset, which is a finding.
            is_damaged = error.code == ExitCode.NOT_RUN and not isinstance(error, LibraryMissingError)
            return _error(str(error), error.hint, ExitCode.FINDINGS if is_damaged else error.code)
        if isinstance(error, MemoryError):
            return _error(f"it takes more than {self._bounds.memory >> 20} MB of memory to be read")
        if isinstance(error, KeyError):
            return _error(f"it lacks {str(error)[:200]}")
        return _error(f"it is damaged, or not what its format says: {type(error).__name__}: {str(error)[:200]}")

    def _open(self, path: str, bounds: Mapping[str, Any]) -> dict[str, Any]:
        self._bounds = ReadLimits(**bounds)
        self._bounds.apply()
        self._bounds.start_cpu_limit()
        self._claims = SizeClaims(path, self._bounds.size)
        self._set = dataset = open_here(Path(path))
        self._claims.add_set(dataset)
        return {"path": dataset.path, "format": dataset.format, "length": len(dataset)}

    def _about(self) -> dict[str, Any]:
        dataset = self._opened
        self._claims.check_rate(dataset.rate_hz)
        return {"rate_hz": dataset.rate_hz, "robot": dataset.robot, "extras": dict(dataset.extras)}

    def _key(self, index: int) -> str:
        return self._opened[index].key

    def _outline(self, index: int) -> list[Any]:
        """Return key, length, instructions, columns, cameras and extras."""
        episode = self._opened[index]
        self._claims.add_episode(index, episode)
        columns = {name: asdict(column) for name, column in episode.columns.items()}
        cameras = {name: vars(camera) for name, camera in episode.cameras.items()}
        return [episode.key, episode.length, list(episode.instructions), columns, cameras, dict(episode.extras)]

    def _read(self, index: int, column: str, start: int, stop: int | None) -> np.ndarray | list[str]:
        rows = self._opened[index].read(column, start, stop)
        return rows if rows.dtype.kind in "biuf" else [str(one) for one in rows]

    def _video(self, index: int, camera: str) -> dict[str, Any] | None:
        clip = self._opened[index].video(camera)
        return None if clip is None else asdict(clip)

    def _stats(self, index: int, camera: str) -> dict[str, Any] | None:
        statistics = self._opened[index].stats(camera)
        return None if statistics is None else dict(statistics)

    def _film(self, index: int, camera: str, start: int, stop: int | None) -> int:
        number, episode = next(self._numbers), self._opened[index]
        first = slice(start, stop).indices(episode.length)[0]
        self._films[number] = self._claims.checked_images(episode, camera, first, episode.frames(camera, start, stop))
        return number

    def _frames(self, number: int) -> list[np.ndarray]:
        images: list[np.ndarray] = []
        for image in self._films[number]:
            images.append(np.ascontiguousarray(image))
            if sum(one.nbytes for one in images) >= _FRAMES_BYTES:
                break
        return images

    def _end(self, number: int) -> None:
        self._films.pop(number, None)

    @property
    def _opened(self) -> Demonstrations:
        if self._set is None:
            raise RuntimeError("no dataset was opened")
        return self._set


def _error(message: str, hint: str | None = None, code: ExitCode | None = None) -> Head:
    return {"error": {"message": message, "hint": hint, "code": None if code is None else int(code)}}
