"""The content of an episode view: evenly spaced frames, and every column as curves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import _spec as sdk
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.formats.image_files import thumbnail
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from xpl_cli.data.sets.interface import Demonstrations, RecordedEpisode

FRAMES: Final = 8
MOST_CURVES: Final = 32
"""Most entries of a row that are drawn."""
_MOST_POINTS: Final = 400
_BLOCK: Final = 1 << 20
"""Numbers of a column that are read at once."""
_WIDEST: Final = 1280
"""Width of a kept image in pixels: that of the picture."""
_DEPTHS: Final = (2.0, 98.0)
"""Percentiles of a depth image that map to black and white."""


@dataclass(frozen=True)
class Strip:
    """Frames of one camera.

    Attributes:
        name: the camera.
        what: its size and encoding.
        steps: which steps they are.
        images: (H, W, 3) uint8 each, in the file's own channel order, downscaled if large.
    """

    name: str
    what: str
    steps: tuple[int, ...]
    images: tuple[NDArray[np.uint8], ...]


@dataclass(frozen=True)
class Chart:
    """One column.

    Attributes:
        name: the column.
        what: its shape and type.
        names: of the curves.
        steps: (N,) steps of the points.
        curves: (N, width) numbers; empty where there are too many.
        beside: (N, width) of the column that is drawn for comparison, the state of an action; None for none.
        low, high: range of the finite numbers.
        lost: count of numbers that are not finite.
    """

    name: str
    what: str
    names: tuple[str, ...]
    steps: NDArray[np.int64]
    curves: NDArray[np.float64]
    beside: NDArray[np.float64] | None
    low: float
    high: float
    lost: int


@dataclass(frozen=True)
class EpisodeView:
    """An episode with everything that is shown of it.

    Attributes:
        path, format, key: of the episode.
        steps: its length.
        rate_hz: steps per second, if known.
        robot: its name in the dataset, if known.
        instructions: language instructions.
        strips: cameras.
        charts: columns.
    """

    path: str
    format: str
    key: str
    steps: int
    rate_hz: float | None
    robot: str | None
    instructions: tuple[str, ...]
    strips: tuple[Strip, ...]
    charts: tuple[Chart, ...]


def find_episode(demonstrations: Demonstrations, name: str) -> RecordedEpisode:
    """Return an episode by its index, from 0, or by its key.

    Raises:
        DataError: there is no such episode.
    """
    count = len(demonstrations)
    if name.isdecimal() and len(name) <= len(str(count)) and int(name) < count:
        return demonstrations[int(name)]
    for index in range(count):
        if demonstrations[index].key == name:
            return demonstrations[index]
    raise DataError(
        f"{demonstrations.path} has no episode {name}: it has {count}, from 0",
        hint=f"`xpl data list {demonstrations.path}` lists them",
        code=ExitCode.NOT_FOUND,
    )


def view(demonstrations: Demonstrations, episode: RecordedEpisode, frames: int = FRAMES) -> EpisodeView:
    """Read what is shown of an episode.

    Raises:
        DataError: a column or an image cannot be read.
    """
    return EpisodeView(
        demonstrations.path,
        demonstrations.format,
        episode.key,
        episode.length,
        demonstrations.rate_hz,
        demonstrations.robot,
        episode.instructions,
        tuple(_strip(episode, name, frames) for name in episode.cameras),
        tuple(_chart(episode, name) for name, column in episode.columns.items() if column.dtype != "str"),
    )


def _strip(episode: RecordedEpisode, name: str, count: int) -> Strip:
    camera = episode.cameras[name]
    steps = tuple(dict.fromkeys(np.linspace(0, max(episode.length - 1, 0), count).round().astype(int).tolist()))
    images = []
    for step in steps if episode.length else ():
        (image,) = episode.frames(name, step, step + 1)
        images.append(thumbnail(_grey(image) if camera.kind == sdk.Camera.DEPTH else image, _WIDEST))
    what = f"{camera.height} x {camera.width} {camera.kind}, {camera.encoding}"
    return Strip(name, what, steps[: len(images)], tuple(images))


def _grey(depth: np.ndarray) -> NDArray[np.uint8]:
    """Return a depth image as grey levels; near is bright."""
    values = depth.astype(np.float64)
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, _DEPTHS) if finite.size else (0.0, 1.0)
    share = np.clip((np.nan_to_num(values, nan=high) - low) / max(high - low, 1e-9), 0, 1)
    return np.repeat((255 * (1 - share)).astype(np.uint8)[..., None], 3, axis=2)


def _chart(episode: RecordedEpisode, name: str) -> Chart:
    column = episode.columns[name]
    width = math.prod(column.shape)
    steps = np.unique(np.linspace(0, episode.length - 1, _MOST_POINTS).round().astype(np.int64))
    is_drawn = width <= MOST_CURVES
    low, high, lost, picked = np.inf, -np.inf, 0, [np.zeros((0, width if is_drawn else 0))]
    for start, rows in _blocks(episode, name, width):
        finite = np.isfinite(rows)
        values = rows[finite]
        low, high = min(low, values.min(initial=np.inf)), max(high, values.max(initial=-np.inf))
        lost += int((~finite).sum())
        if is_drawn:
            picked.append(_picked(rows, start, steps))
    if low > high:
        low = high = 0.0
    other = name.replace("action/", "state/", 1)
    beside = None
    if is_drawn and other != name and other in episode.columns and episode.columns[other].shape == column.shape:
        beside = np.concatenate([_picked(rows, start, steps) for start, rows in _blocks(episode, other, width)])
    what = f"{' x '.join(map(str, column.shape)) or 'one number'}, {column.dtype}"
    names = column.names or tuple(map(str, range(min(width, MOST_CURVES))))
    return Chart(name, what, names, steps, np.concatenate(picked), beside, float(low), float(high), lost)


def _blocks(episode: RecordedEpisode, name: str, width: int) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield blocks of a column, (steps, width), each with the step of its first row."""
    count = max(1, _BLOCK // max(width, 1))
    for start in range(0, episode.length, count):
        rows = episode.read(name, start, start + count)
        yield start, rows.reshape(len(rows), width).astype(np.float64)


def _picked(rows: NDArray[np.float64], start: int, steps: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the rows at the given steps; `start` is the step of the first row."""
    return rows[steps[(steps >= start) & (steps < start + len(rows))] - start]
