"""Episodes written as datasets of an HDF5 group, and what the formats that do so differ in."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl_cli.data.formats import libraries, pictures
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.data.sets.interface import Camera, Episode

SAMPLED: Final = 16
"""Every so many images are decoded again, to tell what they lost."""
_MOST_ATTRIBUTE: Final = 32 << 20


@contextmanager
def created(path: Path) -> Iterator[Any]:
    """Create a file that appears under its name when it is whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}")
    # Attributes above 64 KiB, which models of simulated worlds are, need the newer layout.
    with libraries.h5py().File(partial, "w", libver="latest") as file:
        yield file
    partial.replace(path)


def write(group: Any, episode: Episode, images: str) -> dict[str, float]:
    """Write an episode's columns and cameras; return by camera how near lossy images are, PSNR in dB.

    Args:
        group: where.
        episode: under the names that are written.
        images: raw, png or jpeg.
    """
    for name, column in episode.columns.items():
        if column.dtype == "str":
            kind = libraries.h5py().string_dtype()
            group.create_dataset(name, data=episode.read(name).astype(object), dtype=kind)
        else:
            group.create_dataset(name, data=episode.read(name))
    found = {}
    for name, camera in episode.cameras.items():
        if images == "raw" or camera.kind == "depth":
            _raw(group, episode, name, camera)
        else:
            worst = _encoded(group, episode, name, images)
            if images != "png":
                found[name] = worst
    return found


def attribute(group: Any, values: Mapping[str, Any]) -> list[str]:
    """Write plain data as attributes: texts and numbers as they are, the rest as JSON; return what was too large."""
    large = []
    for name, value in values.items():
        plain = value if isinstance(value, (str, int, float, bool)) else json.dumps(value, ensure_ascii=False)
        if isinstance(plain, str) and len(plain) > _MOST_ATTRIBUTE:
            large.append(name)
        else:
            group.attrs[name] = plain
    return large


def _raw(group: Any, episode: Episode, name: str, camera: Camera) -> None:
    """Write images as numbers, each a chunk of its own."""
    target = None
    for index, frame in enumerate(episode.frames(name)):
        if target is None:
            shape = (episode.length, *frame.shape)
            target = group.create_dataset(name, shape, frame.dtype, chunks=(1, *frame.shape))
        target[index] = frame
    if target is None:
        ends = () if camera.kind == "depth" else (3,)
        group.create_dataset(name, (0, camera.height, camera.width, *ends), np.uint8)


def _encoded(group: Any, episode: Episode, name: str, images: str) -> float:
    """Write encoded images in rows of one length, filled up with NUL; return the worst PSNR of a sample."""
    rows, worst = [], float("inf")
    for index, frame in enumerate(episode.frames(name)):
        data = pictures.encoded(frame, images)
        rows.append(np.frombuffer(data, np.uint8))
        if index % SAMPLED == 0:
            worst = min(worst, pictures.psnr(frame, pictures.pixels(data, name)))
    if not rows:
        raise DataError(f"the episode {episode.key} has no images of {name}")
    target = group.create_dataset(name, (len(rows), max(map(len, rows))), np.uint8, chunks=(1, max(map(len, rows))))
    for index, row in enumerate(rows):
        target[index, : len(row)] = row
    return worst
