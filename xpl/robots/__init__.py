"""Which robots there are: those that come with `xpl`, and those of a project or package.

All are entries of one form, the standard's (`xpl spec show embodiment`), and have unique names. Files
`embodiments/NAME.yml` of a project and of packages are read by the tool, which hands their entries to every process
that it starts; in a program of your own `load` reads one. `xpl.embodiment.get_embodiment` makes a robot of an entry.
"""

from xpl.robots.entry import faults, has_frames, inherit
from xpl.robots.registry import (
    HANDED_ON,
    OURS,
    RobotError,
    canonical,
    entries,
    load,
    names,
    offer,
    origin,
    whole,
)

__all__ = [
    "HANDED_ON",
    "OURS",
    "RobotError",
    "canonical",
    "entries",
    "faults",
    "has_frames",
    "inherit",
    "load",
    "names",
    "offer",
    "origin",
    "whole",
]
