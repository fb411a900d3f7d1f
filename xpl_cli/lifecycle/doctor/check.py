"""The result of a probe of the machine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Status(StrEnum):
    """State of a capability of the machine."""

    OK = "ok"
    """It was tested and works."""
    ABSENT = "absent"
    """It is missing; only what needs it does not work."""
    BROKEN = "broken"
    """It is required or present, and does not work."""


@dataclass(frozen=True)
class MachineCheck:
    """One tested capability.

    Attributes:
        name: name of the capability.
        status: its state.
        result: result of the test, one line.
        serves: what it is needed for.
        fix: how to fix it; None if it works.
    """

    name: str
    status: Status
    result: str
    serves: str
    fix: str | None = None
