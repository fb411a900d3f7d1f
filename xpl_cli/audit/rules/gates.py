"""The gates of an audit."""

from __future__ import annotations

from enum import StrEnum


class Gate(StrEnum):
    """The gates of an audit, cheapest first."""

    STATIC = "static"
    OFFLINE = "offline"
    MUJOCO = "mujoco"
