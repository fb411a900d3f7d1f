"""robomimic's HDF5, and LIBERO's, which adds an instruction: `data/demo_0/{actions,obs/...}`.

Source: robomimic's documentation of its datasets; LIBERO's scripts/create_dataset.py.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import json_text
from xpl.trajectory import TrajectoryError, storage
from xpl_cli.data.formats import hdf5
from xpl_cli.data.formats.hdf5 import Hdf5Episode, natural
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import Demonstrations, Extras

if TYPE_CHECKING:
    from xpl.trajectory.hdf5_types import HDF5File

NAME: Final = "robomimic"
_STEPS: Final = ("actions", "states")
_MOST_EPISODES: Final = 1_000_000


def recognises(path: Path) -> bool:
    """Tell whether a path is a dataset of this format."""
    return hdf5.is_hdf5_set(path, _is_one)


def opened(path: Path) -> RobomimicSet:
    """Return the dataset."""
    return RobomimicSet(path, hdf5.files(path))


def _is_one(file: HDF5File) -> bool:
    try:
        return any(name.startswith("demo") for name in storage.group(file, "data"))
    except TrajectoryError:
        return False


class RobomimicSet(Demonstrations):
    """One file, or a folder with one file per task.

    Args:
        path: the path that was opened.
        files: the files in it.
    """

    def __init__(self, path: Path, files: list[Path]) -> None:
        super().__init__(path, NAME)
        self._files = files

    @property
    def rate_hz(self) -> float | None:
        """`control_freq` of the environment's arguments, if it is there."""
        rate = self._kwargs.get("control_freq")
        return float(rate) if isinstance(rate, (int, float)) and rate > 0 else None

    @property
    def robot(self) -> str | None:
        """The robot's name in robosuite."""
        robots = self._kwargs.get("robots")
        first = robots[0] if isinstance(robots, list) and robots else robots
        return first if isinstance(first, str) else None

    @functools.cached_property
    def extras(self) -> Extras:
        """The attributes of the first file's `data`, with JSON text parsed."""
        with hdf5.opened(self._files[0]) as file:
            return {name: _json(value) for name, value in hdf5.attributes(storage.group(file, "data")).items()}

    def __len__(self) -> int:
        """The number of episodes."""
        return len(self._episodes)

    def __getitem__(self, index: int) -> Hdf5Episode:
        """Return an episode by its index."""
        return self._episodes[index]

    @property
    def _kwargs(self) -> Mapping[str, Any]:
        """The environment's keyword arguments."""
        arguments = self.extras.get("env_args")
        kwargs = arguments.get("env_kwargs") if isinstance(arguments, dict) else None
        return kwargs if isinstance(kwargs, dict) else {}

    @functools.cached_property
    def _episodes(self) -> list[Hdf5Episode]:
        episodes: list[Hdf5Episode] = []
        files = hdf5.OpenFileCache(storage.open_file)
        for path in self._files:
            with hdf5.opened(path) as file:
                group = storage.group(file, "data")
                default_instructions = _language(_json(storage.plain(group.attrs.get("problem_info"))))
                names_by_address: dict[int, str] = {}
                for name in sorted(group, key=natural):
                    demo = storage.group(group, name)
                    first = names_by_address.setdefault(storage.address(demo), name)
                    if first != name:
                        raise DataError(f"{path}: data/{name} is the group data/{first} again; episodes count once")
                    meta = _json(storage.plain(demo.attrs.get("ep_meta")))
                    key = name if len(self._files) == 1 else f"{path.stem}/{name}"
                    episodes.append(
                        Hdf5Episode((path, files), f"data/{name}", key, _STEPS, _language(meta) or default_instructions)
                    )
            if len(episodes) > _MOST_EPISODES:
                raise DataError(f"{self.path} has more than {_MOST_EPISODES} episodes")
        return episodes


def _language(meta: object) -> tuple[str, ...]:
    """Return the instruction in LIBERO's `problem_info`, or in RoboCasa's `ep_meta`."""
    if not isinstance(meta, dict):
        return ()
    sentence = meta.get("language_instruction", meta.get("lang"))
    if isinstance(sentence, list):
        sentence = " ".join(map(str, sentence))  # LIBERO's parser gives words
    return (sentence.strip(),) if isinstance(sentence, str) and sentence.strip() else ()


def _json(value: object) -> Any:
    """Parse JSON text; return any other value unchanged."""
    if isinstance(value, str) and value[:1] in "{[":
        try:
            return json_text.parse(value)
        except json_text.JsonError:
            return value
    return value
