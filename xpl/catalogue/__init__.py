"""Building blocks and registry of conventions; each convention is a module of `xpl.conventions`."""

from __future__ import annotations

from xpl.catalogue.convention import Convention, GeometryStep, ValueTransform, conventions
from xpl.catalogue.mistake import AdapterCase, Mistake

__all__ = ["AdapterCase", "Convention", "GeometryStep", "Mistake", "ValueTransform", "conventions"]
