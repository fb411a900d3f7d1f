"""A folder of trajectories: listed without opening the files."""

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
    """List the trajectories below a folder, sorted by name, without opening them.

    Args:
        path: the folder, or one file.

    Raises:
        TrajectoryError: it does not exist, or has no trajectories.
    """
    root = Path(path)
    files = list(_files(root))
    if not files:
        problem = f"holds no file that ends in {' or '.join(ENDINGS)}; {_OTHERS}" if root.is_dir() else "is not there"
        raise TrajectoryError(f"{path} {problem}")
    return Folder(path, root if root.is_dir() else root.parent, files)


def open_files(paths: Sequence[str | os.PathLike[str]]) -> Folder:
    """Return the trajectories of these files, in order, without opening them. The folder is their common parent."""
    root = Path(os.path.commonpath([Path(path).absolute().parent for path in paths])) if paths else Path()
    return Folder(root, root, [Path(path).absolute().relative_to(root) for path in paths])


class Folder(Sequence[Trajectory]):
    """The trajectories below a folder; see `open_folder` and `open_files`.

    Args:
        path: the path that was passed.
        root: the folder.
        files: paths relative to it.

    Attributes:
        path: the folder.
        keys: path of each relative to the folder, without suffix.
    """

    def __init__(self, path: str | os.PathLike[str], root: Path, files: Sequence[Path]) -> None:
        self.path = os.fspath(path)
        self._root, self._files = root, files
        self.keys = tuple(name.with_suffix("").as_posix() for name in self._files)
        self._indices: dict[Path, dict[str, index.IndexEntry]] = {}

    def __len__(self) -> int:
        """Return the number of trajectories."""
        return len(self._files)

    @overload
    def __getitem__(self, place: int) -> Trajectory: ...

    @overload
    def __getitem__(self, place: slice) -> list[Trajectory]: ...

    def __getitem__(self, place: int | slice) -> Trajectory | list[Trajectory]:
        """Return a trajectory by index; it is opened on first access."""
        if isinstance(place, slice):
            return [self[number] for number in range(len(self))[place]]
        file = self._root / self._files[place]
        return Trajectory(str(file), key=self.keys[place], steps=self._indexed_steps(file))

    def __iter__(self) -> Iterator[Trajectory]:
        """Yield the trajectories."""
        return (self[number] for number in range(len(self)))

    @property
    def steps(self) -> int:
        """Number of control steps of all trajectories; opens those without an index entry."""
        return sum(map(len, self))

    def _indexed_steps(self, file: Path) -> int | None:
        """Return the steps of a file from the folder's index; None without an entry of its current size."""
        if file.parent not in self._indices:
            self._indices[file.parent] = index.read(file.parent)
        line = self._indices[file.parent].get(file.name)
        return line.steps if line is not None and line.bytes == file.stat().st_size else None


def _files(path: Path) -> Iterator[Path]:
    """Yield the files below a folder, sorted; hidden files are incomplete or not trajectories."""
    if not path.is_dir():
        if path.is_file():
            yield Path(path.name)
        return
    count = 0
    for folder, folders, names in os.walk(path):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            if name.endswith(ENDINGS) and not name.startswith("."):
                count += 1
                if count > _MOST_FILES:
                    raise TrajectoryError(f"{path} holds more than {_MOST_FILES} files: name a folder of fewer")
                yield Path(folder, name).relative_to(path)
