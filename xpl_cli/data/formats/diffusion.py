"""Diffusion Policy's zarr: arrays of all steps below `data/`, and where episodes end in `meta/episode_ends`.

Source: Diffusion Policy's common/replay_buffer.py; zarr's format 2. It has no place for sentences and rates: these are
attributes here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl.images import PIXELS
from xpl_cli.data.formats import libraries
from xpl_cli.data.formats.writing import CONVERTED, Names
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import Camera, Column

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl_cli.data.formats.writing import Plan
    from xpl_cli.data.sets.interface import Episode

NAME: Final = "diffusion-policy"
ENDS: Final = "meta/episode_ends"
_SET: Final = "set.zarr"
_SMALLEST = 8
_ROWS: Final = 4096
_MOST_CHUNK: Final = 1 << 30
_TOLD: Final = ("episodes", "rate_hz", "robot", "extras")


def recognises(path: Path) -> bool:
    """Tell whether a folder is one."""
    return (path / "meta" / "episode_ends").is_dir()


class DiffusionSet:
    """A store."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with _opened(path) as store:
            ends = store.get(ENDS)
            if ends is None or "data" not in store:
                raise DataError(f"{path} has no data and {ENDS}, which Diffusion Policy's stores have")
            self._ends: list[int] = np.asarray(ends[:], np.int64).tolist()
            self._told: dict[str, Any] = dict(store.attrs)
            self.contents = {name: _told(name, array) for name, array in sorted(store["data"].arrays())}
        starts = [0, *self._ends]
        if any(end < start for start, end in zip(starts, self._ends, strict=False)):
            raise DataError(f"{path}: {ENDS} does not rise")

    @property
    def path(self) -> str:
        """The folder or ZIP file."""
        return str(self._path)

    @property
    def format(self) -> str:
        """The name of its format."""
        return NAME

    @property
    def rate_hz(self) -> float | None:
        """Steps per second, where an attribute says so."""
        rate = self._told.get("rate_hz")
        return float(rate) if isinstance(rate, (int, float)) and rate > 0 else None

    @property
    def robot(self) -> str | None:
        """What an attribute calls the robot."""
        told = self._told.get("robot")
        return told if isinstance(told, str) else None

    @property
    def extras(self) -> Mapping[str, Any]:
        """The attributes."""
        extras = self._told.get("extras")
        rest = {key: value for key, value in self._told.items() if key not in _TOLD}
        return {**(extras if isinstance(extras, dict) else {}), **rest}

    def __len__(self) -> int:
        """How many episodes there are."""
        return len(self._ends)

    def __getitem__(self, index: int) -> DiffusionEpisode:
        """Return an episode, by its place."""
        place = range(len(self._ends))[index]
        start = self._ends[place - 1] if place else 0
        told = self._told.get("episodes")
        one = told[place] if isinstance(told, list) and len(told) == len(self._ends) else {}
        return DiffusionEpisode(self, place, (start, self._ends[place]), one if isinstance(one, dict) else {})

    def rows(self, name: str, start: int, stop: int) -> NDArray[Any]:
        """Return rows of an array, counted over the set."""
        with _opened(self._path) as store:
            found: NDArray[Any] = np.asarray(store["data"][name][start:stop])
        if len(found) != stop - start:
            raise DataError(f"{self._path}: {name} has {len(found)} of the rows {start} to {stop}")
        return found


class DiffusionEpisode:
    """The rows of one episode."""

    def __init__(self, owner: DiffusionSet, index: int, span: tuple[int, int], told: Mapping[str, Any]) -> None:
        self._owner, self._index, self._told = owner, index, told
        self._start, self._stop = span

    @property
    def key(self) -> str:
        """Its name in the set."""
        return f"episode_{self._index:06d}"

    @property
    def length(self) -> int:
        """How many steps it has."""
        return self._stop - self._start

    @property
    def instructions(self) -> tuple[str, ...]:
        """What the robot was told, where attributes say so."""
        return tuple(map(str, self._told.get("instructions") or ()))

    @property
    def columns(self) -> Mapping[str, Column]:
        """The columns of numbers."""
        return {name: one for name, one in self._owner.contents.items() if isinstance(one, Column)}

    @property
    def cameras(self) -> Mapping[str, Camera]:
        """The cameras."""
        return {name: one for name, one in self._owner.contents.items() if isinstance(one, Camera)}

    @property
    def extras(self) -> Mapping[str, Any]:
        """What attributes say of it."""
        extras = self._told.get("extras")
        return extras if isinstance(extras, dict) else {}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> NDArray[Any]:
        """Return rows of a column."""
        if column not in self.columns:
            raise KeyError(column)
        first, last, _ = slice(start, stop).indices(self.length)
        return self._owner.rows(column, self._start + first, self._start + max(first, last))

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera."""
        if camera not in self.cameras:
            raise KeyError(camera)
        for index in range(*slice(start, stop).indices(self.length)):
            image = self._owner.rows(camera, self._start + index, self._start + index + 1)[0]
            yield image if image.dtype == np.uint8 else np.clip(np.rint(image), 0, 255).astype(np.uint8)


class DiffusionWriter:
    """Writes a store of format 2: images at once, each a chunk of its own, numbers when all are there."""

    name = NAME
    names = Names("action", "", "", "")

    def keeps(self, column: Column) -> str | None:
        """Return why a column cannot be kept."""
        return "Diffusion Policy's zarr has no texts" if column.dtype == "str" else None

    def shows(self, camera: Camera) -> str | None:
        """Return why a camera cannot be kept."""
        return None if camera.kind == "color" else "depth images are no part of Diffusion Policy's zarr"

    def check(self, plan: Plan) -> None:
        """Stop before anything is written."""
        if plan.options.images not in ("auto", "raw"):
            raise DataError(f"Diffusion Policy's zarr keeps images raw, got --images {plan.options.images}")

    def piece(self, folder: Path, plan: Plan, index: int, episode: Episode) -> dict[str, Any]:
        """Write one episode's images to their place, and its numbers beside."""
        start = plan.starts[index]
        for name in plan.cameras:
            target = _images(folder / _SET, name, plan)
            for place, frame in enumerate(episode.frames(name)):
                target[start + place] = frame
        beside = folder / "numbers"
        beside.mkdir(exist_ok=True)
        with (beside / f"{index:06d}.npz").open("wb") as stream:
            np.savez(
                stream,
                allow_pickle=False,
                **{str(place): episode.read(name) for place, name in enumerate(plan.columns)},
            )
        return {"extras": dict(episode.extras)}

    def finish(self, folder: Path, plan: Plan, pieces: list[dict[str, Any]]) -> Path:
        """Write the numbers, where episodes end, and the attributes."""
        zarr = libraries.zarr()
        total = sum(plan.lengths)
        store = zarr.open_group(str(folder / _SET), mode="a", zarr_format=2)
        data = store.require_group("data")
        arrays = [
            data.create_array(
                name,
                shape=(total, *column.shape),
                dtype=column.dtype,
                chunks=(min(_ROWS, max(total, 1)), *column.shape),
                compressors=_compressor(),
                overwrite=True,
            )
            for name, column in plan.columns.items()
        ]
        for index, start in enumerate(plan.starts):
            with np.load(folder / "numbers" / f"{index:06d}.npz", allow_pickle=False) as found:
                for place, array in enumerate(arrays):
                    array[start : start + plan.lengths[index]] = found[str(place)]
        ends = np.cumsum(np.array(plan.lengths, np.int64))
        meta = store.require_group("meta")
        meta.create_array("episode_ends", data=ends, chunks=ends.shape, compressors=None, overwrite=True)
        store.attrs.update(
            {
                "rate_hz": plan.rate_hz,
                "robot": plan.robot,
                "extras": {key: value for key, value in plan.extras.items() if key != CONVERTED},
                CONVERTED: plan.extras.get(CONVERTED, {}),
                "episodes": [
                    {"instructions": list(told), "extras": piece["extras"]}
                    for told, piece in zip(plan.instructions, pieces, strict=True)
                ],
            }
        )
        return folder / _SET


def _images(path: Path, name: str, plan: Plan) -> Any:
    """Return the array of a camera's images, made by whichever process comes first: all would make the same."""
    zarr = libraries.zarr()
    camera = plan.cameras[name]
    shape = (sum(plan.lengths), camera.height, camera.width, 3)
    zarr.open_group(str(path), mode="a", zarr_format=2).require_group("data")
    where = path / "data" / name
    if not (where / ".zarray").is_file():
        zarr.open_array(
            str(where),
            mode="a",
            shape=shape,
            dtype="uint8",
            chunks=(1, *shape[1:]),
            zarr_format=2,
            compressor=_compressor(),
        )
    return zarr.open_array(str(where), mode="r+")


def _compressor() -> Any:
    import numcodecs

    return numcodecs.Blosc(cname="zstd", clevel=5, shuffle=numcodecs.Blosc.BITSHUFFLE)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    zarr = libraries.zarr()
    try:
        store = zarr.storage.ZipStore(path, mode="r") if path.suffix == ".zip" else str(path)
        yield zarr.open_group(store, mode="r")
    except DataError:
        raise
    except Exception as error:  # noqa: BLE001 - zarr and its codecs raise almost anything on damaged stores
        raise DataError(f"{path} cannot be read as zarr: {str(error)[:200]}") from None


def _told(name: str, array: Any) -> Column | Camera:
    """Return what an array is: a camera if its rows are images of bytes, or of floats 0..255 as in Push-T."""
    shape, dtype = array.shape, np.dtype(array.dtype)
    if dtype.kind not in "biuf":
        raise DataError(f"{name} holds {dtype}, which is not read: texts and objects need pickle")
    chunk = int(np.prod(array.chunks or (1,), dtype=np.int64)) * dtype.itemsize
    if chunk > _MOST_CHUNK:
        raise DataError(f"{name} has chunks of {chunk} bytes, more than {_MOST_CHUNK}")
    if len(shape) == 4 and shape[3] == 3 and min(shape[1:3]) >= _SMALLEST and shape[1] * shape[2] <= PIXELS:
        return Camera(shape[1], shape[2], encoding="raw" if dtype == np.uint8 else dtype.name)
    return Column(tuple(shape[1:]), dtype.name)
