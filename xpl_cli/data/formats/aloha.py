"""ACT's and ALOHA's HDF5: `observations/{qpos,images/...}` and `action`, one file an episode.

Source: record_sim_episodes.py of ACT, record_episodes.py of ALOHA (whose images may be JPEGs in rows of one length).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from xpl_cli.data.formats.folders import FolderSet, ToldEpisode

NAME: Final = "aloha"
_STEPS: Final = ("action", "observations/qpos")


def recognises(file: Any) -> bool:
    """Tell whether an open HDF5 file is one."""
    return "action" in file and "observations" in file


def opened(path: Path, files: list[Path]) -> FolderSet:
    """Return the set in these files."""
    return FolderSet(path, NAME, files, lambda file, key: ToldEpisode(file, "", key, _STEPS))
