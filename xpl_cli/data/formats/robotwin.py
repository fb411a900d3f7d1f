"""RoboTwin 2.0's HDF5: `joint_action`, `endpose`, `observation/<camera>/rgb`, and instructions in separate files.

Source: RoboTwin's pkl2hdf5.py and its description of the data. Its JPEGs have red and blue swapped, because RGB was
passed to an encoder that expects BGR.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl.trajectory import storage
from xpl_cli.basics import files as bounded
from xpl_cli.data.formats import hdf5
from xpl_cli.data.formats.folders import FolderSet, sentences
from xpl_cli.data.formats.hdf5 import Hdf5Episode
from xpl_cli.data.sets import documents
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import Extras

NAME: Final = "robotwin"
_STEPS: Final = ("joint_action/vector", "joint_action/left_gripper", "endpose/left_endpose")
_MOST: Final = 16 << 20
_SENTENCES: Final = {"type": ["array", "null"], "items": {"type": "string"}}
_SCHEMA: Final = documents.schema_text(
    {
        "anyOf": [
            {"type": "string"},
            {"type": "array", "items": {"type": "string"}},
            {"type": "object", "properties": {"seen": _SENTENCES, "unseen": _SENTENCES}},
        ]
    }
)
"""Schema of an instruction file: one, several, or a map of those that training sees and those that it does not."""


def recognises(path: Path) -> bool:
    """Tell whether a path is a dataset of this format."""
    return hdf5.is_hdf5_set(path, lambda file: "joint_action" in file and "observation" in file)


def opened(path: Path) -> FolderSet:
    """Return the dataset."""
    files = hdf5.OpenFileCache(storage.open_file)
    return FolderSet(path, NAME, hdf5.files(path), lambda file, key: _RobotwinEpisode((file, files), "", key, _STEPS))


class _RobotwinEpisode(Hdf5Episode):
    """An episode whose instructions are in `../instructions/<the same name>.json`."""

    def _sentences(self, extras: Extras) -> tuple[str, ...]:
        """Return the instructions of that file, in several wordings."""
        del extras
        path = self._path.parent.parent / "instructions" / f"{self._path.stem}.json"
        try:
            instructions = documents.validate_value(
                documents.parse_json(bounded.read_regular(path, _MOST), str(path)), _SCHEMA, str(path)
            )
        except FileNotFoundError:
            return ()
        except OSError as error:
            raise DataError(f"{path} cannot be read: {error}") from None
        if isinstance(instructions, dict):  # those that training sees come first
            instructions = [sentence for key in ("seen", "unseen") for sentence in instructions.get(key) or []]
        return sentences(instructions)
