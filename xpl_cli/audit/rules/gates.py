"""The gates of an audit."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Final

from xpl_cli.packages.package import ENV, POLICY


class Gate(StrEnum):
    """The gates of an audit, cheapest first."""

    STATIC = "static"
    OFFLINE = "offline"
    MUJOCO = "mujoco"


class DataGate(StrEnum):
    """The one gate of demonstrations, which are no package."""

    DATA = "data"


DEMONSTRATIONS: Final = "demonstrations"
"""The kind of target that a set of demonstrations is."""

GATES: Final[Mapping[str, tuple[Gate, ...]]] = {POLICY: tuple(Gate), ENV: (Gate.STATIC, Gate.OFFLINE)}
"""The gates of each kind of package."""
