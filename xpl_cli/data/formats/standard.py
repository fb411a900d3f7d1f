"""The standard's own HDF5 form, which RoboDojo's sets have: `state/`, `action/` and `vision/<camera>/`.

Source: spec/v1/trajectory.schema.json.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as spec
from xpl_cli.data.formats import pictures
from xpl_cli.data.formats.folders import FolderSet, ToldEpisode

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

NAME: Final = "xpl"
FACTS: Final = "additional_info/episode"
"""Facts of the episode, JSON text, as `xpl.trajectory` writes them."""
_SIDES: Final = ("", "left_", "right_")
_SERIES: Final = tuple(f"{stem}{end}" for stem in ("arm_joint_state", "ee_pose", "ee_joint_state") for end in ("s", ""))
_STEPS: Final = tuple(
    f"{group}/{side}{series}" for group in ("state", "action") for series in _SERIES for side in _SIDES
)


def recognises(file: Any) -> bool:
    """Tell whether an open HDF5 file is one."""
    return spec.Obs.STATE in file and (spec.Obs.VISION in file or "action" in file)


def opened(path: Path, files: list[Path]) -> FolderSet:
    """Return the set in these files."""
    return FolderSet(path, NAME, files, lambda file, key: _Episode(file, "", key, _STEPS))


class _Episode(ToldEpisode):
    """An episode, whose JPEGs are RGB by the standard's rule: with its mark as they are, without it exchanged."""

    @functools.cached_property
    def extras(self) -> Mapping[str, Any]:
        """What the file says beside its parts, with the facts of the episode opened."""
        found = dict(super().extras)
        told = found.pop(FACTS, None)
        try:
            facts = json.loads(told) if isinstance(told, str) else {}
        except ValueError:
            facts = {}
        return {**found, **(facts if isinstance(facts, dict) else {})}

    def decoded(self, data: bytes, where: str) -> NDArray[np.uint8]:
        """Return the pixels of an encoded image, RGB."""
        return pictures.pixels_rgb(data, where)
