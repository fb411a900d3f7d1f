"""The dataset that a writer reads: converted by a mapping, with packed or unpacked series."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.conversion import mapping as mappings
from xpl_cli.data.conversion.packing import PackedSet, UnpackedSet
from xpl_cli.data.conversion.provenance import Provenance
from xpl_cli.data.conversion.standard import NAME, NativeSet, StandardizedSet
from xpl_cli.data.reading import open_set
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import Demonstrations


def open_source(path: Path, to: str, by: str | None, written_by: str | None) -> Demonstrations:
    """Open a dataset and wrap it in the conversions that the writer needs.

    Args:
        path: of the dataset.
        to: name of the output format.
        by: mapping of the side that is not in the standard's format.
        written_by: mapping of the output, where neither side is in the standard's format.

    Raises:
        DataError: the dataset cannot be read, or a mapping is invalid or would convert nothing.
    """
    dataset = open_set(path)
    if by is not None and dataset.format != NAME:
        dataset = StandardizedSet(dataset, mappings.load(by))
        by = None
    elif dataset.format != NAME and to == NAME:
        dataset = _unpack(dataset)
    mapping_name = by or written_by
    if mapping_name is None:
        is_packed = dataset.format == NAME and to != NAME and len(dataset) > 0
        return PackedSet(dataset) if is_packed else dataset
    if dataset.format != NAME or to == NAME:
        raise DataError(
            f"a mapping converts between another format and the standard; from {dataset.format} to {to} "
            f"the mapping {mapping_name} has nothing to convert",
            code=ExitCode.USAGE,
        )
    return NativeSet(dataset, mappings.load(mapping_name))


def mapped_names(to: str, by: str | None, written_by: str | None) -> frozenset[str]:
    """Return the column and camera names that a mapping assigns in the output."""
    mapping_name = written_by or by
    if to == NAME or mapping_name is None:
        return frozenset()
    mapping = mappings.load(mapping_name)
    return frozenset((*mapping.images, *mapping.states, *mapping.columns))


def _unpack(dataset: Demonstrations) -> Demonstrations:
    """Return a dataset with unpacked series, if it was converted from one in the standard's format."""
    origin = Provenance.of(dataset)
    return dataset if origin.layout is None else UnpackedSet(dataset, origin.names, origin.numbers, origin.layout)
