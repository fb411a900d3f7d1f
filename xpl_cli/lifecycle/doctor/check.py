"""What a probe of the machine answers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Status(StrEnum):
    """How something stands."""

    OK = "ok"
    """It was tried, and works."""
    ABSENT = "absent"
    """It is not there; what needs it says so, and the rest works."""
    BROKEN = "broken"
    """It is needed by everything, or there and does not work."""


@dataclass(frozen=True)
class MachineCheck:
    """One thing that was tried.

    Attributes:
        name: what it is.
        status: how it stands.
        found: what was found, one line.
        serves: what it is good for.
        mend: what to do if it is not there, None if nothing has to be done.
    """

    name: str
    status: Status
    found: str
    serves: str
    mend: str | None = None
