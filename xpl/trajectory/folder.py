"""A folder of trajectories: listed at once, opened one by one."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import overload

from xpl.trajectory import index
from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.reading import Trajectory

ENDINGS = (".hdf5", ".h5")
_MOST_FILES = 1 << 20
_OTHERS = "demonstrations of another format: xpl data convert SRC DST --to xpl"


def open_folder(path: str | os.PathLike[str]) -> Folder:
    """Return the trajectories below a folder, sorted by their names; none is opened.

    Args:
        path: the folder, or one file.

    Raises:
        TrajectoryError: it is not there, or holds none.
    """
    root = Path(path)
    found = list(_files(root))
    if not found:
        told = f"holds no file that ends in {' or '.join(ENDINGS)}; {_OTHERS}" if root.is_dir() else "is not there"
        raise TrajectoryError(f"{path} {told}")
    return Folder(path, root if root.is_dir() else root.parent, found)


def open_files(paths: Sequence[str | os.PathLike[str]]) -> Folder:
    """Return the trajectories in these files, in their order; none is opened. The folder is where all of them lie."""
    root = Path(os.path.commonpath([Path(path).absolute().parent for path in paths])) if paths else Path()
    return Folder(root, root, [Path(path).absolute().relative_to(root) for path in paths])


class Folder(Sequence[Trajectory]):
    """The trajectories below a folder; see `open_folder` and `open_files`.

    Args:
        path: what was opened.
        root: the folder.
        files: relative to it.

    Attributes:
        path: the folder.
        keys: the name of each, relative to the folder and without its ending.
    """

    def __init__(self, path: str | os.PathLike[str], root: Path, files: Sequence[Path]) -> None:
        self.path = os.fspath(path)
        self._root, self._files = root, files
        self.keys = tuple(name.with_suffix("").as_posix() for name in self._files)
        self._indices: dict[Path, dict[str, index.Line]] = {}

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._files)

    @overload
    def __getitem__(self, place: int) -> Trajectory: ...

    @overload
    def __getitem__(self, place: slice) -> list[Trajectory]: ...

    def __getitem__(self, place: int | slice) -> Trajectory | list[Trajectory]:
        """Return a trajectory by its place; it is opened when something of it is asked for."""
        if isinstance(place, slice):
            return [self[number] for number in range(len(self))[place]]
        file = self._root / self._files[place]
        return Trajectory(str(file), key=self.keys[place], steps=self._known_steps(file))

    def __iter__(self) -> Iterator[Trajectory]:
        """Yield one after the other."""
        return (self[number] for number in range(len(self)))

    @property
    def steps(self) -> int:
        """Control steps of all of them together; opens those of which the index says nothing."""
        return sum(map(len, self))

    def _known_steps(self, file: Path) -> int | None:
        """Return the steps that the folder's index says of a file as it is; None where it says nothing."""
        if file.parent not in self._indices:
            self._indices[file.parent] = index.lines(file.parent)
        line = self._indices[file.parent].get(file.name)
        return line.steps if line is not None and line.bytes == file.stat().st_size else None


def _files(path: Path) -> Iterator[Path]:
    """Yield the files below a folder, sorted; hidden ones are being written, or are somebody else's."""
    if not path.is_dir():
        if path.is_file():
            yield Path(path.name)
        return
    count = 0
    for place, folders, found in os.walk(path):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(found):
            if name.endswith(ENDINGS) and not name.startswith("."):
                count += 1
                if count > _MOST_FILES:
                    raise TrajectoryError(f"{path} holds more than {_MOST_FILES} files: name a folder of fewer")
                yield Path(place, name).relative_to(path)
