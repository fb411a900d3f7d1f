"""The environment's manifest, `env.yml`, parsed once."""

from __future__ import annotations

from functools import cache
from typing import Any

from xpl.environment import read_manifest
from xpl.manifest import EnvManifest


@cache
def manifest() -> EnvManifest:
    """Return `env.yml`."""
    return read_manifest(__file__)


def manifest_for(arms: int) -> dict[str, Any]:
    """Return the manifest as a map for robots of so many arms: one arm is seen from elsewhere than two."""
    facts = manifest().data
    cameras = {name: dict(entry) for name, entry in facts["cameras"].items()}
    for entry in cameras.values():
        alone = entry.pop("one_arm", {})
        if arms == 1:
            entry.update(alone)
    return {**facts, "cameras": cameras}
