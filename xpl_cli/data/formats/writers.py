"""The formats that are written, by name."""

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
    """Return what writes a format.

    Raises:
        UnknownNameError: nothing does.
    """
    wanted = one_of("--to", "lerobot-v3.0" if name == "lerobot" else name, WRITTEN)
    return next(writer for writer in WRITERS if writer.name == wanted)
