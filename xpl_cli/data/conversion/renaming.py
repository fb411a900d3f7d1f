"""What columns and cameras of one format are called in another, and an episode under these names."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl_cli.data.conversion import packing
from xpl_cli.data.conversion.provenance import Provenance
from xpl_cli.data.formats.lerobot import layout
from xpl_cli.data.formats.writers import WRITERS
from xpl_cli.data.formats.writing import CONVERTED, NamingScheme
from xpl_cli.data.sets.delegating import DelegatingEpisode, base_format
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Extras, VideoClip

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from xpl_cli.data.formats.writing import DatasetWriter
    from xpl_cli.data.sets.interface import Demonstrations, RecordedEpisode

COLOR, DEPTH = sdk.Camera.COLOR, sdk.Camera.DEPTH
_READ_ONLY: Final = {
    "robomimic": NamingScheme("actions", "", "obs/", "obs/"),
    "aloha": NamingScheme("action", "observations/qpos", "observations/", "observations/images/"),
    "robotwin": NamingScheme("joint_action/vector", "", "", "observation/"),
    "diffusion-policy": NamingScheme("action", "", "", ""),
    "rlds": NamingScheme("action", "observation/state", "observation/", "observation/"),
    packing.NAME: NamingScheme(packing.ACTION, packing.STATE, "", "vision/", environment=packing.ENVIRONMENT),
}
"""How formats that are not written call things."""
_ANY: Final = NamingScheme("action", "", "", "")
"""How another format, which an installed package reads, is taken to call things."""
_OWN: Final = (
    *(CONVERTED, "frequency", "robot", "num_samples", "ep_meta", "instruction", "instructions"),
    *("data_format_version", "additional_info/frequency"),
)
"""Facts of an episode that are written anew."""
_LEAVES: Final = {
    "robotwin": {COLOR: "/rgb", DEPTH: "/depth"},
    "xpl": {leaf: f"/{sdk.TRAJECTORY_CAMERA[leaf]}" for leaf in (COLOR, DEPTH)},
}
"""What stands behind a camera's name where a camera is a group, by what its images are."""
_DERIVED: Final = {"lerobot": tuple(layout.DEFAULTS)}
"""Columns that say nothing that the format does not know otherwise, and that are written anew."""


@dataclass(frozen=True)
class Renaming:
    """Which columns and cameras are written, and how they are called.

    Attributes:
        columns: by the name that is written, that of the source.
        cameras: likewise.
        numbers: columns whose rows are single numbers, and which the source has as arrays of one.
        lost: by the source's name, why it is not written.
    """

    columns: Mapping[str, str]
    cameras: Mapping[str, str]
    numbers: frozenset[str]
    lost: Mapping[str, str]

    @property
    def changed(self) -> dict[str, str]:
        """The names that had to change: by the name that is written, that of the source."""
        both = {**self.columns, **self.cameras}
        return {new: old for new, old in both.items() if new != old}


def plan_renaming(
    source: Demonstrations, writer: DatasetWriter, rate_hz: float | None, given: frozenset[str] = frozenset()
) -> Renaming:
    """Return how a set's names become those of a format.

    A set that was made of one of that format gets the names back that it had there.

    Args:
        source: the set.
        writer: of the format.
        rate_hz: steps per second.
        given: names that a mapping gave, which stay as they are.
    """
    first = source[0]
    before = Provenance.of(source)
    if family(before.format) != family(writer.name):
        before = Provenance()
    dropped = _DERIVED.get(family(base_format(source)), ())
    lost: dict[str, str] = {}
    columns: dict[str, str] = {}
    numbers = []
    for name, column in first.columns.items():
        if name in dropped or (name == "timestamp" and _is_regular(first, rate_hz)):
            continue
        reason = writer.column_rejection(column)
        if reason is not None:
            lost[name] = reason
            continue
        wanted = name if name in given else before.names.get(name) or _target_name(name, source.format, writer.names)
        new = _unique_name(wanted, columns, writer)
        columns[new] = name
        if name in before.numbers and math.prod(column.shape) == 1:
            numbers.append(new)
    cameras: dict[str, str] = {}
    for name, camera in first.cameras.items():
        reason = writer.camera_rejection(camera)
        if reason is not None:
            lost[name] = reason
        else:
            new = (
                name
                if name in given
                else before.names.get(name) or _camera_name(name, camera.kind, source.format, writer)
            )
            cameras[_unique_name(new, {**columns, **cameras}, writer)] = name
    return Renaming(columns, cameras, frozenset(numbers), lost)


def family(name: str) -> str:
    """Return a format's name without its version."""
    return name.partition("-v")[0]


class RenamedEpisode(DelegatingEpisode):
    """An episode under the names of another format; with no more columns and cameras than are written."""

    def __init__(self, inner: RecordedEpisode, how: Renaming) -> None:
        super().__init__(inner)
        self._how = how

    @property
    def columns(self) -> Mapping[str, ColumnInfo]:
        """The columns."""
        has = self._inner.columns
        return {
            new: ColumnInfo((), has[old].dtype) if new in self._how.numbers else has[old]
            for new, old in self._how.columns.items()
            if old in has
        }

    @property
    def cameras(self) -> Mapping[str, CameraInfo]:
        """The cameras."""
        has = self._inner.cameras
        return {new: has[old] for new, old in self._how.cameras.items() if old in has}

    @property
    def extras(self) -> Extras:
        """What else is said of it, without what every format says in its own way."""
        return {name: value for name, value in self._inner.extras.items() if name not in _OWN}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        rows = self._inner.read(self._how.columns[column], start, stop)
        return rows.reshape(len(rows)) if column in self._how.numbers else rows

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera."""
        return self._inner.frames(self._how.cameras[camera], start, stop)

    def video(self, camera: str) -> VideoClip | None:
        """Return where a camera's video lies; None if it has none."""
        return self._inner.video(self._how.cameras[camera])

    def stats(self, camera: str) -> Mapping[str, Any] | None:
        """Return the statistics of a camera that the set has; None if it has none."""
        return self._inner.stats(self._how.cameras[camera])


def _target_name(name: str, given: str, wanted: NamingScheme) -> str:
    """Return what a column is called in another format."""
    has = _naming_of(given)
    if has.action and name == has.action and wanted.action:
        return wanted.action
    if has.state and name == has.state:
        return wanted.state or f"{wanted.within}state"
    if has.environment and name == has.environment and wanted.environment:
        return wanted.environment
    if has.within and name.startswith(has.within):
        return wanted.within + name.removeprefix(has.within)
    return name


def _naming_of(given: str) -> NamingScheme:
    name = family(given)
    written = {family(writer.name): writer.names for writer in WRITERS}
    return {**written, **_READ_ONLY}.get(name, _ANY)


def _camera_name(name: str, kind: str, given: str, writer: DatasetWriter) -> str:
    short = name.removeprefix(_naming_of(given).camera)
    wanted = _LEAVES.get(writer.name, {}).get(kind, "")
    if kind == COLOR or wanted:  # else depth would be called as the colour beside it
        for leaves in _LEAVES.values():
            short = short.removesuffix(leaves[kind])
    return writer.names.camera + short + wanted


def _unique_name(name: str, taken: Mapping[str, str], writer: DatasetWriter) -> str:
    """Return a name with the format's separators that nothing else has."""
    if writer.names.separator != "/":
        name = name.replace("/", writer.names.separator)
    if family(writer.name) == "lerobot" and name in layout.DEFAULTS:
        name = f"recorded_{name}"
    while name in taken:
        name += "_"
    return name


def _is_regular(episode: RecordedEpisode, rate_hz: float | None) -> bool:
    """Tell whether times are those that the rate tells anyway."""
    import numpy as np

    if rate_hz is None or not episode.length or episode.columns["timestamp"].dtype == "str":
        return False
    times = np.asarray(episode.read("timestamp"), np.float64).reshape(episode.length, -1)[:, 0]
    return bool(np.abs(times - np.arange(len(times)) / rate_hz).max() < 1e-4)
