"""Whether a package is still there: one that is run may remove its own files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

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
        """Look at a folder."""
        return cls(path, tuple(sorted(file.name for file in path.iterdir() if file.is_file())) if path.is_dir() else ())

    @property
    def loss(self) -> str | None:
        """What has gone since, in words; None if all is there."""
        gone = [name for name in self.names if not (self.path / name).is_file()]
        if not gone:
            return None
        more = f" and {len(gone) - _SHOWN} more" if len(gone) > _SHOWN else ""
        return f"the package removed files of its own while it ran: {', '.join(gone[:_SHOWN])}{more}"
