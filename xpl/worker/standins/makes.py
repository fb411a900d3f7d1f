"""What is known of makes of models: functions and classes that stand in for some names of some modules.

A package adds its own with an entry point of the group `xpl_standins`: a function that takes the sizes of an action
(`xpl.worker.standins.facts.Facts`) and returns a map from dotted names to what stands in for them. A name ends with
what is imported; `*.name` holds in every module.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from typing import Any

from xpl.worker.standins.facts import Facts

GROUP = "xpl_standins"
_known: dict[str, Any] = {}


def load(facts: Facts) -> None:
    """Learn what this package and others know."""
    from xpl.worker.standins import models

    _known.clear()
    _known.update(models.known(facts))
    found: Any = importlib.metadata.entry_points()
    chosen = found.select(group=GROUP) if hasattr(found, "select") else found.get(GROUP, [])
    for point in chosen:
        _known.update(point.load()(facts))


def find(name: str) -> Any:
    """Return what stands in for a dotted name, None if nothing in particular does."""
    return _known.get(name) or _known.get(f"*.{name.rpartition('.')[2]}")


def parts(module: str) -> Mapping[str, Any]:
    """Return what is known of a module."""
    return {name.rpartition(".")[2]: item for name, item in _known.items() if name.rpartition(".")[0] == module}
