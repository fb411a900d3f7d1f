"""Names of the standard that rules of several gates compare with."""

from __future__ import annotations

from xpl import _spec as sdk


def robots() -> frozenset[str]:
    """Return every name that stands for an embodiment of the standard, aliases included."""
    return frozenset(name for key, entry in sdk.EMBODIMENTS.items() for name in (key, *entry.get("aliases", ())))
