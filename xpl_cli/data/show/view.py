"""What is shown of an episode: frames at even distances, and every column as curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import _spec as sdk
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl_cli.data.sets.interface import Demonstrations, Episode

FRAMES: Final = 8
MOST_CURVES: Final = 32
"""Entries of a row that are still drawn."""
_MOST_POINTS: Final = 400
_DEPTHS: Final = (2.0, 98.0)
"""Percentiles of a depth image between which it is shown."""


@dataclass(frozen=True)
class Strip:
    """Frames of one camera.

    Attributes:
        name: the camera.
        what: its size and encoding.
        steps: which steps they are.
        images: (H, W, 3) uint8 each, in the file's own order of channels.
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
        steps: (N,) at which they are drawn.
        curves: (N, width) numbers; empty where there are too many.
        beside: (N, width) of the column that it is drawn beside, the state of an action; None for none.
        low, high: range of all numbers that are finite.
        lost: how many are not.
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
class View:
    """An episode as it is shown.

    Attributes:
        path, format, key: which one it is.
        steps: its length.
        rate_hz: steps per second, if known.
        robot: what the set calls it.
        instructions: what it was told.
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


def chosen(demonstrations: Demonstrations, wanted: str) -> Episode:
    """Return an episode by its place, counted from 0, or by its key.

    Raises:
        DataError: there is none.
    """
    count = len(demonstrations)
    if wanted.isdigit() and int(wanted) < count:
        return demonstrations[int(wanted)]
    for index in range(count):
        if demonstrations[index].key == wanted:
            return demonstrations[index]
    raise DataError(
        f"{demonstrations.path} has no episode {wanted}: it has {count}, from 0",
        hint=f"`xpl data list {demonstrations.path}` lists them",
        code=ExitCode.NOT_FOUND,
    )


def view(demonstrations: Demonstrations, episode: Episode, frames: int = FRAMES) -> View:
    """Return what is shown of an episode.

    Raises:
        DataError: something of it cannot be read.
    """
    return View(
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


def _strip(episode: Episode, name: str, count: int) -> Strip:
    camera = episode.cameras[name]
    steps = tuple(dict.fromkeys(np.linspace(0, max(episode.length - 1, 0), count).round().astype(int).tolist()))
    images = []
    for step in steps if episode.length else ():
        (image,) = episode.frames(name, step, step + 1)
        images.append(_grey(image) if camera.kind == sdk.Camera.DEPTH else image)
    what = f"{camera.height} x {camera.width} {camera.kind}, {camera.encoding}"
    return Strip(name, what, steps[: len(images)], tuple(images))


def _grey(depth: np.ndarray) -> NDArray[np.uint8]:
    """Return a depth image as grey levels, near is bright."""
    values = depth.astype(np.float64)
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, _DEPTHS) if known.size else (0.0, 1.0)
    share = np.clip((np.nan_to_num(values, nan=high) - low) / max(high - low, 1e-9), 0, 1)
    return np.repeat((255 * (1 - share)).astype(np.uint8)[..., None], 3, axis=2)


def _chart(episode: Episode, name: str) -> Chart:
    column = episode.columns[name]
    rows = _flat(episode, name)
    finite = np.isfinite(rows)
    known = rows[finite]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    steps = np.unique(np.linspace(0, max(len(rows) - 1, 0), _MOST_POINTS).round().astype(np.int64))[: len(rows)]
    is_drawn = rows.shape[1] <= MOST_CURVES
    other = name.replace("action/", "state/", 1)
    beside = None
    if is_drawn and other != name and other in episode.columns and episode.columns[other].shape == column.shape:
        beside = _flat(episode, other)[steps]
    what = f"{' x '.join(map(str, column.shape)) or 'one number'}, {column.dtype}"
    names = column.names or tuple(map(str, range(rows.shape[1])))
    curves = rows[steps] if is_drawn else np.zeros((0, 0))
    return Chart(name, what, names, steps, curves, beside, low, high, int((~finite).sum()))


def _flat(episode: Episode, name: str) -> NDArray[np.float64]:
    rows = episode.read(name)
    return rows.reshape(len(rows), -1).astype(np.float64)
