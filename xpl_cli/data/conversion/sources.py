"""What stands between a set and a writer: conventions by a mapping, and series that are packed or unpacked."""

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
    """Return a set as a writer gets it.

    Args:
        path: the set.
        to: the format that is written.
        by: the mapping of the side that is not the standard's.
        written_by: the mapping of the result, where neither is.

    Raises:
        DataError: the set cannot be read, or a mapping does not hold or has nothing to do.
    """
    found = open_set(path)
    if by is not None and found.format != NAME:
        found = StandardizedSet(found, mappings.load(by))
        by = None
    elif found.format != NAME and to == NAME:
        found = _unpack(found)
    wanted = by or written_by
    if wanted is None:
        is_packed = found.format == NAME and to != NAME and len(found) > 0
        return PackedSet(found) if is_packed else found
    if found.format != NAME or to == NAME:
        raise DataError(
            f"a mapping says what a set of the field means by the standard; from {found.format} to {to} by {wanted} "
            "leaves nothing to say",
            code=ExitCode.USAGE,
        )
    return NativeSet(found, mappings.load(wanted))


def mapped_names(to: str, by: str | None, written_by: str | None) -> frozenset[str]:
    """Return the names that a mapping gives to what is written."""
    wanted = written_by or by
    if to == NAME or wanted is None:
        return frozenset()
    mapping = mappings.load(wanted)
    return frozenset((*mapping.images, *mapping.states, *mapping.columns))


def _unpack(found: Demonstrations) -> Demonstrations:
    """Return a set with the standard's series again, if it was made of one that had them."""
    origin = Provenance.of(found)
    return found if origin.layout is None else UnpackedSet(found, origin.names, origin.numbers, origin.layout)
