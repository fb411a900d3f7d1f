"""The standard's own HDF5 form, which RoboDojo's sets have: `state/`, `action/` and `vision/<camera>/`.

Source: spec/v1/trajectory.schema.json.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from xpl import _spec as spec
from xpl_cli.data.formats.folders import FolderSet, ToldEpisode

NAME: Final = "xpl"
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
    return FolderSet(path, NAME, files, lambda file, key: ToldEpisode(file, "", key, _STEPS))
