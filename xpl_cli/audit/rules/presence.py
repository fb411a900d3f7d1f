"""Whether a package is still there: one that is run may remove its own files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from xpl_cli.basics.words import listed

if TYPE_CHECKING:
    from pathlib import Path

_SHOWN = 3


@dataclass(frozen=True)
class Presence:
    """The files that a package's folder held when it was looked at first."""

    path: Path
    names: tuple[str, ...]

    @classmethod
    def of(cls, path: Path) -> Self:
        """Look at a folder; one that cannot be read has no files that could go."""
        try:
            names = sorted(os.listdir(path))  # noqa: PTH208 - names are all that is asked for
        except OSError:
            names = []
        return cls(path, tuple(name for name in names if _is_file(path / name)))

    @property
    def loss(self) -> str | None:
        """What has gone since, in words; None if all is there."""
        gone = [name for name in self.names if not _is_file(self.path / name)]
        if not gone:
            return None
        return f"the package removed files of its own while it ran: {listed(gone, _SHOWN)}"


def _is_file(path: Path) -> bool:
    return os.path.isfile(path)  # noqa: PTH113 - Path.is_file raises where nobody may look
