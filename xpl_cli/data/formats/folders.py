"""Sets that are one HDF5 file an episode: ACT / ALOHA, RoboTwin, and the standard's own form."""

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

_RATE = (f"{spec.Trajectory.ADDITIONAL_INFO}/{spec.Obs.FREQUENCY}", "frequency", "fps", "control_freq")
"""Names under which files of this kind keep steps per second."""
_TOLD = ("instruction", "instructions", "language_instruction", "language_raw", "task_description")
"""Names under which files of this kind keep a sentence."""


class FolderSet(Demonstrations):
    """A folder of files, or one file.

    Args:
        path: what was opened.
        name: the format.
        files: one for each episode.
        opens: makes an episode of a file and a key.
    """

    def __init__(self, path: Path, name: str, files: list[Path], opens: Callable[[Path, str], RecordedEpisode]) -> None:
        super().__init__(path, name)
        self._files, self._opens = files, opens

    @functools.cached_property
    def rate_hz(self) -> float | None:
        """Steps per second, if the first episode says so."""
        extras = self[0].extras if self._files else {}
        for name in _RATE:
            told = extras.get(name)
            if isinstance(told, (int, float)) and told > 0:
                return float(told)
        return None

    @property
    def robot(self) -> str | None:
        """What the first episode calls its robot, if it does."""
        extras = self[0].extras if self._files else {}
        told = next((extras[name] for name in ("robot", "embodiment", "robot_type") if name in extras), None)
        return told if isinstance(told, str) else None

    @functools.cached_property
    def extras(self) -> Extras:
        """Of what the set was made, as the first file says it; each file speaks for itself."""
        told = self[0].extras.get(CONVERTED) if self._files else None
        try:
            return {CONVERTED: json_text.parse(told) if isinstance(told, str) else told} if told else {}
        except json_text.JsonError:
            return {}

    def __len__(self) -> int:
        """How many episodes there are."""
        return len(self._files)

    def __getitem__(self, index: int) -> RecordedEpisode:
        """Return an episode, by its place."""
        return self._episodes[index]

    @functools.cached_property
    def _episodes(self) -> list[RecordedEpisode]:
        names = [path.stem for path in self._files]
        is_unique = len(set(names)) == len(names)
        keys = names if is_unique else [path.relative_to(self.path).with_suffix("").as_posix() for path in self._files]
        return [self._opens(path, key) for path, key in zip(self._files, keys, strict=True)]


class InlineInstructionEpisode(Hdf5Episode):
    """An episode whose file has its sentence itself."""

    def _sentences(self, extras: Extras) -> tuple[str, ...]:
        """Return those in an attribute or a dataset of one of the usual names."""
        return instructions_in(extras)


def instructions_in(extras: Extras) -> tuple[str, ...]:
    """Return the sentences under one of the usual names."""
    return next(filter(None, (sentences(extras.get(name)) for name in _TOLD)), ())


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
