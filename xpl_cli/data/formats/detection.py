"""Detection of a dataset's format by its content."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl.registry import BUILT_IN_DISTRIBUTION
from xpl_cli.basics import formats
from xpl_cli.data.formats import hdf5
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.data.sets.interface import Demonstrations


def open_here(path: Path) -> Demonstrations:
    """Open a dataset in this process (`xpl_cli.data.reading` opens it in a process of its own).

    Formats of installed packages come before the built-in ones, because they are more specific.

    Raises:
        DataError: no format recognises the path, or the files are damaged.
        EntryPointError: a format of an installed package cannot be used.
    """
    readers = formats.registered(formats.DATA)
    for entry in sorted(readers.values(), key=lambda entry: entry.distribution == BUILT_IN_DISTRIBUTION):
        if formats.call(entry, "recognises", path):
            dataset: Demonstrations = formats.call(entry, "opened", path)
            return dataset
    hint = f"formats that are read: {', '.join(readers)}"
    if (first := hdf5.first(path)) is not None:
        with hdf5.opened(first) as file:
            names = ", ".join(list(file)[:20]) or "nothing"
        raise DataError(f"{first} is an HDF5 file in an unknown format: its root has {names}", hint=hint)
    raise DataError(f"no format recognises {path} as demonstrations", hint=hint)
