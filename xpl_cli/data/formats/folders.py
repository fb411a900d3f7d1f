"""Datasets with one HDF5 file per episode: ACT / ALOHA, RoboTwin, and the standard's own format."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as spec
from xpl import json_text
from xpl_cli.data.formats.hdf5 import Hdf5Episode
from xpl_cli.data.formats.writing import CONVERTED
from xpl_cli.data.sets.interface import Demonstrations, Extras

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import RecordedEpisode

_RATE_KEYS = (f"{spec.Trajectory.ADDITIONAL_INFO}/{spec.Obs.FREQUENCY}", "frequency", "fps", "control_freq")
"""Keys under which these files store steps per second."""
_INSTRUCTION_KEYS = ("instruction", "instructions", "language_instruction", "language_raw", "task_description")
"""Keys under which these files store an instruction."""


class FolderSet(Demonstrations):
    """A folder of files, or one file.

    Args:
        path: the path that was opened.
        name: of the format.
        files: one for each episode.
        opens: returns the episode of a file and a key.
    """

    def __init__(self, path: Path, name: str, files: list[Path], opens: Callable[[Path, str], RecordedEpisode]) -> None:
        super().__init__(path, name)
        self._files, self._opens = files, opens

    @functools.cached_property
    def rate_hz(self) -> float | None:
        """Steps per second, if the first episode has them."""
        extras = self[0].extras if self._files else {}
        for name in _RATE_KEYS:
            rate = extras.get(name)
            if isinstance(rate, (int, float)) and rate > 0:
                return float(rate)
        return None

    @property
    def robot(self) -> str | None:
        """The robot's name in the first episode, if it has one."""
        extras = self[0].extras if self._files else {}
        robot = next((extras[name] for name in ("robot", "embodiment", "robot_type") if name in extras), None)
        return robot if isinstance(robot, str) else None

    @functools.cached_property
    def extras(self) -> Extras:
        """The provenance record of the first file; other metadata belongs to each episode."""
        record = self[0].extras.get(CONVERTED) if self._files else None
        try:
            return {CONVERTED: json_text.parse(record) if isinstance(record, str) else record} if record else {}
        except json_text.JsonError:
            return {}

    def __len__(self) -> int:
        """The number of episodes."""
        return len(self._files)

    def __getitem__(self, index: int) -> RecordedEpisode:
        """Return an episode by its index."""
        return self._episodes[index]

    @functools.cached_property
    def _episodes(self) -> list[RecordedEpisode]:
        names = [path.stem for path in self._files]
        is_unique = len(set(names)) == len(names)
        keys = names if is_unique else [path.relative_to(self.path).with_suffix("").as_posix() for path in self._files]
        return [self._opens(path, key) for path, key in zip(self._files, keys, strict=True)]


class InlineInstructionEpisode(Hdf5Episode):
    """An episode whose file holds its instruction."""

    def _sentences(self, extras: Extras) -> tuple[str, ...]:
        """Return the instructions in an attribute or dataset under one of the usual keys."""
        return instructions_in(extras)


def instructions_in(extras: Extras) -> tuple[str, ...]:
    """Return the instructions under one of the usual keys."""
    return next(filter(None, (sentences(extras.get(name)) for name in _INSTRUCTION_KEYS)), ())


def sentences(value: object) -> tuple[str, ...]:
    """Return the sentences in a value: one, several, or none."""
    if isinstance(value, str):
        if value[:1] == "[":
            try:
                return sentences(json_text.parse(value))
            except json_text.JsonError:
                pass
        return (value,) if value.strip() else ()
    if isinstance(value, list):
        return tuple(item for item in value if isinstance(item, str) and item.strip())
    return ()
