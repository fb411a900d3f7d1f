"""Types of the parts of h5py that are used here; h5py has none."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np


class HDF5Dataset(Protocol):
    """An array of a file."""

    name: str
    file: HDF5File
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


class HDF5Group(Protocol):
    """A group of a file, or the open file itself."""

    id: object
    name: str
    file: HDF5File
    attrs: MutableMapping[str, object]

    def __iter__(self) -> Iterator[str]:
        """Yield the names in it."""

    def __contains__(self, name: object) -> bool:
        """Return whether it has an entry of this name."""

    def __getitem__(self, name: str) -> Any:
        """Return the group or dataset of a name; links are followed."""

    def __delitem__(self, name: str) -> None:
        """Delete an entry."""

    def get(self, name: str, *, getlink: bool) -> object:
        """Return the link of an entry."""

    def create_dataset(self, name: str, *arguments: object, **options: object) -> HDF5Dataset:
        """Create a dataset."""


class HDF5File(HDF5Group, Protocol):
    """An open file."""

    filename: str

    def __enter__(self) -> HDF5File:  # noqa: PYI034 - Python 3.9 has no Self
        """Return the file."""

    def __exit__(self, *error: object) -> None:
        """Close the file."""

    def close(self) -> None:
        """Close the file."""
