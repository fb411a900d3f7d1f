"""The environment's manifest, `env.yml`, parsed once."""

from __future__ import annotations

from functools import cache
from typing import Any

from xpl.environment import read_manifest


@cache
def manifest() -> dict[str, Any]:
    """Return `env.yml` as a map; callers do not change it."""
    return read_manifest(__file__)


def manifest_for(arms: int) -> dict[str, Any]:
    """Return the manifest as it applies to robots of so many arms: one arm is seen from elsewhere than two."""
    facts = manifest()
    cameras = {name: dict(entry) for name, entry in facts["cameras"].items()}
    for entry in cameras.values():
        alone = entry.pop("one_arm", {})
        if arms == 1:
            entry.update(alone)
    return {**facts, "cameras": cameras}
