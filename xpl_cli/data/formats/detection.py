"""Which format a file or folder is in, found by looking into it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl.registry import OURS
from xpl_cli.basics import formats
from xpl_cli.data.formats import hdf5
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.data.sets.interface import Demonstrations


def open_here(path: Path) -> Demonstrations:
    """Return the demonstrations in a file or folder, read by this process (`xpl_cli.data.reading` has one for it).

    Formats of installed packages are asked before ours: they know something more particular.

    Raises:
        DataError: nothing is known there, or it is damaged.
        EntryPointError: a format of an installed package cannot be used.
    """
    known = formats.registered(formats.DATA)
    for entry in sorted(known.values(), key=lambda entry: entry.distribution == OURS):
        if formats.call(entry, "recognises", path):
            found: Demonstrations = formats.call(entry, "opened", path)
            return found
    hint = f"formats that are read: {', '.join(known)}"
    if (first := hdf5.first(path)) is not None:
        with hdf5.opened(first) as file:
            names = ", ".join(list(file)[:20]) or "nothing"
        raise DataError(f"{first} is HDF5 of no known kind: it has {names}", hint=hint)
    raise DataError(f"{path} holds no demonstrations that are known", hint=hint)
