"""What h5py, which has no types, gives of a file: as much of its datasets and groups as is used here."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np


class Dataset(Protocol):
    """An array of a file."""

    name: str
    file: File
    attrs: MutableMapping[str, object]
    shape: tuple[int, ...]
    ndim: int
    size: int
    dtype: np.dtype[Any]
    chunks: tuple[int, ...] | None
    external: object
    is_virtual: bool

    def __getitem__(self, index: object) -> Any:
        """Return what is stored there."""

    def __setitem__(self, index: object, value: object) -> None:
        """Store a value there."""

    def resize(self, size: object, axis: int | None = None) -> None:
        """Change its shape."""


class Group(Protocol):
    """A group of a file, or the open file itself."""

    id: object
    name: str
    file: File
    attrs: MutableMapping[str, object]

    def __iter__(self) -> Iterator[str]:
        """Yield the names in it."""

    def __contains__(self, name: object) -> bool:
        """Tell whether it has a name."""

    def __getitem__(self, name: str) -> Any:
        """Return the group or dataset of a name; links are followed."""

    def __delitem__(self, name: str) -> None:
        """Take a name out."""

    def get(self, name: str, *, getlink: bool) -> object:
        """Return the link that a name is."""

    def create_dataset(self, name: str, *arguments: object, **options: object) -> Dataset:
        """Make a dataset."""


class File(Group, Protocol):
    """An open file."""

    filename: str

    def __enter__(self) -> File:  # noqa: PYI034 - Python 3.9 has no Self
        """Return the file."""

    def __exit__(self, *error: object) -> None:
        """Close the file."""

    def close(self) -> None:
        """Close the file."""
