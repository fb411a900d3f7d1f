"""The names of columns and cameras in another format, and an episode under those names."""

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
"""Naming schemes of the formats that are only read."""
_ANY: Final = NamingScheme("action", "", "", "")
"""The naming scheme assumed for a format that an installed package reads."""
_OWN: Final = (
    *(CONVERTED, "frequency", "robot", "num_samples", "ep_meta", "instruction", "instructions"),
    *("data_format_version", "additional_info/frequency"),
)
"""Metadata of an episode that the writer produces itself."""
_LEAVES: Final = {
    "robotwin": {COLOR: "/rgb", DEPTH: "/depth"},
    "xpl": {leaf: f"/{sdk.TRAJECTORY_CAMERA[leaf]}" for leaf in (COLOR, DEPTH)},
}
"""Suffix of a camera's name in formats where a camera is a group, by kind of image."""
_DERIVED: Final = {"lerobot": tuple(layout.DEFAULTS)}
"""Columns that the format derives from others; the writer produces them itself."""


@dataclass(frozen=True)
class Renaming:
    """Which columns and cameras are written, and under which names.

    Attributes:
        columns: the source's name of each column, by the name that is written.
        cameras: likewise.
        numbers: scalar columns that the source stores as arrays of length 1.
        lost: why a column or camera is not written, by the source's name.
    """

    columns: Mapping[str, str]
    cameras: Mapping[str, str]
    numbers: frozenset[str]
    lost: Mapping[str, str]

    @property
    def changed(self) -> dict[str, str]:
        """The source's name of each renamed column and camera, by the name that is written."""
        both = {**self.columns, **self.cameras}
        return {new: old for new, old in both.items() if new != old}


def plan_renaming(
    source: Demonstrations, writer: DatasetWriter, rate_hz: float | None, mapped_names: frozenset[str] = frozenset()
) -> Renaming:
    """Choose the names of a dataset's columns and cameras in another format.

    A dataset that was converted from that format gets back the names that it had there.

    Args:
        source: the dataset.
        writer: of the output format.
        rate_hz: steps per second.
        mapped_names: names that a mapping assigned; they are kept.
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
        target_name = (
            name if name in mapped_names else before.names.get(name) or _target_name(name, source.format, writer.names)
        )
        new = _unique_name(target_name, columns, writer)
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
                if name in mapped_names
                else before.names.get(name) or _camera_name(name, camera.kind, source.format, writer)
            )
            cameras[_unique_name(new, {**columns, **cameras}, writer)] = name
    return Renaming(columns, cameras, frozenset(numbers), lost)


def family(name: str) -> str:
    """Return a format's name without its version."""
    return name.partition("-v")[0]


class RenamedEpisode(DelegatingEpisode):
    """An episode under the names of another format, with only the columns and cameras that are written."""

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
        """Metadata of the episode, without the keys that each format writes itself."""
        return {name: value for name, value in self._inner.extras.items() if name not in _OWN}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        rows = self._inner.read(self._how.columns[column], start, stop)
        return rows.reshape(len(rows)) if column in self._how.numbers else rows

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera."""
        return self._inner.frames(self._how.cameras[camera], start, stop)

    def video(self, camera: str) -> VideoClip | None:
        """Return a camera's video clip; None if it has none."""
        return self._inner.video(self._how.cameras[camera])

    def stats(self, camera: str) -> Mapping[str, Any] | None:
        """Return the dataset's own statistics of a camera's images; None if it has none."""
        return self._inner.stats(self._how.cameras[camera])


def _target_name(name: str, source_format: str, target_scheme: NamingScheme) -> str:
    """Return what a column is called in another format."""
    has = _naming_of(source_format)
    if has.action and name == has.action and target_scheme.action:
        return target_scheme.action
    if has.state and name == has.state:
        return target_scheme.state or f"{target_scheme.within}state"
    if has.environment and name == has.environment and target_scheme.environment:
        return target_scheme.environment
    if has.within and name.startswith(has.within):
        return target_scheme.within + name.removeprefix(has.within)
    return name


def _naming_of(format_name: str) -> NamingScheme:
    name = family(format_name)
    written = {family(writer.name): writer.names for writer in WRITERS}
    return {**written, **_READ_ONLY}.get(name, _ANY)


def _camera_name(name: str, kind: str, source_format: str, writer: DatasetWriter) -> str:
    short = name.removeprefix(_naming_of(source_format).camera)
    leaf = _LEAVES.get(writer.name, {}).get(kind, "")
    if kind == COLOR or leaf:  # else depth would be called as the colour beside it
        for leaves in _LEAVES.values():
            short = short.removesuffix(leaves[kind])
    return writer.names.camera + short + leaf


def _unique_name(name: str, used_names: Mapping[str, str], writer: DatasetWriter) -> str:
    """Return a name that is not in use, with the format's separators."""
    if writer.names.separator != "/":
        name = name.replace("/", writer.names.separator)
    if family(writer.name) == "lerobot" and name in layout.DEFAULTS:
        name = f"recorded_{name}"
    while name in used_names:
        name += "_"
    return name


def _is_regular(episode: RecordedEpisode, rate_hz: float | None) -> bool:
    """Tell whether the timestamps are step / rate_hz, to 0.1 ms."""
    import numpy as np

    if rate_hz is None or not episode.length or episode.columns["timestamp"].dtype == "str":
        return False
    times = np.asarray(episode.read("timestamp"), np.float64).reshape(episode.length, -1)[:, 0]
    return bool(np.abs(times - np.arange(len(times)) / rate_hz).max() < 1e-4)
