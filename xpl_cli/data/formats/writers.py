"""The output formats, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl_cli.basics.errors import one_of
from xpl_cli.data.formats.lerobot.writer import LeRobotWriter
from xpl_cli.data.formats.standard import StandardWriter

if TYPE_CHECKING:
    from xpl_cli.data.formats.writing import DatasetWriter

WRITERS: Final[tuple[DatasetWriter, ...]] = (LeRobotWriter(), StandardWriter())
WRITTEN: Final = tuple(writer.name for writer in WRITERS)


def writer_of(name: str) -> DatasetWriter:
    """Return the writer of a format.

    Raises:
        UnknownNameError: there is none.
    """
    full_name = one_of("--to", "lerobot-v3.0" if name == "lerobot" else name, WRITTEN)
    return next(writer for writer in WRITERS if writer.name == full_name)
