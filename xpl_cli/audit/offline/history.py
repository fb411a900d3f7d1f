"""How far back a manifest says that its policy looks, and which inputs it says that of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.manifest import Manifest

_GROUPS = {"images": sdk.Obs.VISION, "state": sdk.Obs.STATE}
"""Parts of an observation, as the native block calls them."""


def reach(manifest: Manifest) -> int:
    """Return over how many observations the declared history reaches, the newest included; 1 without one."""
    told = _told(manifest)
    span = (told.get("length", 1) - 1) * stride(manifest) + 1
    return max(manifest.temporal.history, int(span))


def stride(manifest: Manifest) -> int:
    """Return how many observations the frames of the declared history lie apart."""
    return int(_told(manifest).get("stride", 1))


def groups(manifest: Manifest) -> list[tuple[str, ...]]:
    """Return the parts of earlier observations that have to count, each alone; all together where nothing says it."""
    native = manifest.native or {}
    read = [name for name in _told(manifest).get("of", _GROUPS) if native.get(name)]
    found: list[tuple[str, ...]] = [(_GROUPS[name],) for name in read if _told(manifest)]
    return found or [tuple(_GROUPS.values())]


def _told(manifest: Manifest) -> Mapping[str, Any]:
    return (manifest.native or {}).get("history") or {}
