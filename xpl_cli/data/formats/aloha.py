"""ACT's and ALOHA's HDF5: `observations/{qpos,images/...}` and `action`, one file an episode.

Source: record_sim_episodes.py of ACT, record_episodes.py of ALOHA (whose images may be JPEGs in rows of one length).
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from xpl.trajectory import storage
from xpl_cli.data.formats import hdf5
from xpl_cli.data.formats.folders import FolderSet, InlineInstructionEpisode

NAME: Final = "aloha"
_STEPS: Final = ("action", "observations/qpos")


def recognises(path: Path) -> bool:
    """Tell whether a path is a dataset of this format."""
    return hdf5.is_hdf5_set(path, lambda file: "action" in file and "observations" in file)


def opened(path: Path) -> FolderSet:
    """Return the dataset."""
    files = hdf5.OpenFileCache(storage.open_file)
    return FolderSet(
        path, NAME, hdf5.files(path), lambda file, key: InlineInstructionEpisode((file, files), "", key, _STEPS)
    )
