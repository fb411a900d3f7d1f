"""Optional libraries that only datasets need: imported on use; `LibraryMissingError` where one is missing."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Final

from xpl_cli.basics.extras import how_to_install
from xpl_cli.data.sets import limits
from xpl_cli.data.sets.errors import LibraryMissingError

_EXTRA: Final = "data"


def h5py() -> ModuleType:
    """Return the module `h5py`."""
    return _imported("h5py", "HDF5 files")


def parquet() -> ModuleType:
    """Return the module `pyarrow.parquet`."""
    return _imported("pyarrow.parquet", "parquet files")


def arrow() -> ModuleType:
    """Return the module `pyarrow`."""
    return _imported("pyarrow", "parquet files")


def av() -> ModuleType:
    """Return the module `av`."""
    return _imported("av", "videos")


def zarr() -> ModuleType:
    """Return the module `zarr`."""
    return _imported("zarr", "zarr stores")


def _imported(name: str, what: str) -> ModuleType:
    try:
        with limits.outside_limits():
            return importlib.import_module(name)
    except ImportError as error:
        raise LibraryMissingError(
            f"{what} need the library {name.partition('.')[0]}, which cannot be imported here: {error}",
            hint=how_to_install(_EXTRA),
        ) from None
