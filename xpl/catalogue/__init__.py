"""What a convention is written with, and where all of them are found; each is a module of `xpl.conventions`."""

from __future__ import annotations

from xpl.catalogue.convention import Convention, Stage, Step, conventions
from xpl.catalogue.mistake import Case, Mistake

__all__ = ["Case", "Convention", "Mistake", "Stage", "Step", "conventions"]
