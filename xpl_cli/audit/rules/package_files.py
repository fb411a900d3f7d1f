"""Detect files that a package removed while it ran."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from xpl_cli.basics.phrases import join_limited

if TYPE_CHECKING:
    from pathlib import Path

_SHOWN = 3


@dataclass(frozen=True)
class PackageFiles:
    """The files directly in a package's folder before it ran."""

    path: Path
    names: tuple[str, ...]

    @classmethod
    def of(cls, path: Path) -> Self:
        """Return the files of a folder; none if it cannot be read."""
        try:
            names = sorted(os.listdir(path))  # noqa: PTH208 - only names are needed
        except OSError:
            names = []
        return cls(path, tuple(name for name in names if _is_file(path / name)))

    @property
    def loss(self) -> str | None:
        """A sentence on files removed since, or None."""
        gone = [name for name in self.names if not _is_file(self.path / name)]
        if not gone:
            return None
        return f"the package removed files of its own while it ran: {join_limited(gone, _SHOWN)}"


def _is_file(path: Path) -> bool:
    return os.path.isfile(path)  # noqa: PTH113 - Path.is_file raises without permission
