"""Sets of demonstrations that were made to execute, to hang or to take all memory: each is one error, soon."""

from __future__ import annotations

import itertools
import json
import os
import pickle
import resource
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.data import datasets
from xpl.trajectory import TrajectoryError, open_folder
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.reading import open_set
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.limits import ReadLimits

Make = Callable[[Path], Any]
DEEP = "[" * 100_000
PICKLE = {"id": "pickle", "protocol": 4}


class _Execute:
    def __init__(self, mark: Path) -> None:
        self._mark = mark

    def __reduce__(self) -> Any:
        return Path.touch, (self._mark,)


def everything(path: Path) -> None:
    """Open a set, and read all that it has, as commands do."""
    found = open_set(path)
    _ = found.rate_hz, found.robot, found.extras
    for index in range(len(found)):
        episode = found[index]
        _ = episode.length, episode.instructions, episode.extras
        for column in episode.columns:
            episode.read(column)
        for camera in episode.cameras:
            for _ in episode.frames(camera):
                pass


# -- zarr --------------------------------------------------------------------------------------------------------------


def _array(folder: Path, chunk: bytes | None = None, **declared: Any) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    told = {"zarr_format": 2, "compressor": None, "filters": None, "order": "C", "fill_value": 0, **declared}
    (folder / ".zarray").write_text(json.dumps(told))
    if chunk is not None:
        (folder / ".".join("0" * len(told["shape"]))).write_bytes(chunk)


def _ends(path: Path, chunk: bytes | None = None, **declared: Any) -> Path:
    """Write a store that is right but for its episode_ends, which every reader touches first."""
    for folder in (path, path / "data", path / "meta"):
        folder.mkdir(parents=True)
        (folder / ".zgroup").write_text('{"zarr_format": 2}')
    _array(path / "data" / "action", np.zeros((9, 2), "f4").tobytes(), shape=[9, 2], chunks=[9, 2], dtype="<f4")
    _array(path / "meta" / "episode_ends", chunk, **{"shape": [1], "chunks": [1], "dtype": "<i8", **declared})
    return path


def _executes(path: Path, *, is_zipped: bool = False, **declared: Any) -> Path:
    chunk = pickle.dumps([_Execute(path.parent / "executed")])
    packed = zlib.compress(chunk) if (declared.get("compressor") or {}).get("id") == "zlib" else chunk
    _ends(path, packed, **declared)
    return Path(shutil.make_archive(str(path), "zip", path)) if is_zipped else path


@pytest.mark.parametrize(
    "declared",
    [
        # These two execute with numcodecs before 0.16.6 where nobody looks.
        {"dtype": "|O", "filters": [{"id": "vlen-utf8"}, PICKLE], "fill_value": ""},
        {"dtype": "|O", "filters": [{"id": "vlen-bytes"}], "compressor": PICKLE, "fill_value": ""},
        {"dtype": "|O", "filters": [PICKLE]},
        {"dtype": "|O", "filters": [PICKLE], "compressor": {"id": "zlib", "level": 1}},
        {"dtype": "|O", "filters": [{"id": "delta", "dtype": "<i8"}, PICKLE]},
        {"compressor": PICKLE},
        {"filters": [PICKLE]},
        {"filters": [{"id": "delta", "dtype": "<i8"}, PICKLE]},
        {"dtype": "|O", "filters": [PICKLE], "is_zipped": True},
        {"compressor": PICKLE, "is_zipped": True},
    ],
)
def test_no_codec_of_a_store_executes_anything(tmp_path: Path, declared: dict[str, Any]) -> None:
    """Whatever the library would do: what an array says of itself is read before its chunks."""
    path = _executes(tmp_path / "store", **declared)
    with pytest.raises(DataError, match=r"episode_ends/\.zarray: (dtype|compressor|filters)") as caught:
        everything(path)
    assert caught.value.code == ExitCode.FINDINGS
    assert not (tmp_path / "executed").exists()


def _arrays(path: Path) -> None:
    _ends(path)
    for number in range(1100):
        _array(path / "data" / f"column_{number}", shape=[1], chunks=[1], dtype="<f4")


ZARR: dict[str, Make] = {
    "1,100 arrays": _arrays,
    "an end twice": lambda path: _ends(path, np.array([5, 5]).tobytes(), shape=[2], chunks=[2]),
    "claims a petabyte of ends": lambda path: _ends(path, shape=[1 << 50], chunks=[1 << 20]),
    "one chunk is a bomb": lambda path: _ends(
        path, zlib.compress(bytes(1 << 26)), shape=[1 << 20], chunks=[1 << 20], compressor={"id": "zlib", "level": 1}
    ),
    "chunks of two gigabytes": lambda path: _ends(path, shape=[1 << 20], chunks=[1 << 28]),
    "a deep declaration": lambda path: (_ends(path) / "meta/episode_ends/.zarray").write_text(DEEP),
    "deep attributes": lambda path: (_ends(path) / ".zattrs").write_text(DEEP),
    "no shape": lambda path: (_ends(path) / "meta/episode_ends/.zarray").write_text("{}"),
    "falls": lambda path: _ends(path, np.array([5, 3]).tobytes(), shape=[2], chunks=[2]),
    "beyond its rows": lambda path: _ends(path, np.array([1 << 40]).tobytes()),
}

# -- HDF5 --------------------------------------------------------------------------------------------------------------


def _hdf5(change: Callable[[h5py.File], Any]) -> Make:
    """Return what writes ALOHA's form with a change."""

    def make(path: Path) -> None:
        path.mkdir()
        with h5py.File(path / "episode_0.hdf5", "w") as file:
            file["action"] = file["observations/qpos"] = np.zeros((5, 14), "f4")
            change(file)

    return make


def _web(links: int, levels: int) -> Callable[[h5py.File], None]:
    """Return what makes groups of which each has many links to the next."""

    def change(file: h5py.File) -> None:
        groups = [file.create_group(f"web{number}") for number in range(levels)]
        for (one, other), number in itertools.product(itertools.pairwise(groups), range(links)):
            one[f"to{number}"] = other

    return change


def _fixed(width: int, count: int) -> Callable[[h5py.File], None]:
    """Return what claims texts of fixed width, of which none is stored."""

    def change(file: h5py.File) -> None:
        kind = h5py.h5t.C_S1.copy()
        kind.set_size(width)
        created = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        created.set_chunk((1,))
        h5py.h5d.create(file.id, b"instruction", kind, h5py.h5s.create_simple((count,)), created)

    return change


def _zeros(file: h5py.File) -> None:
    del file["action"], file["observations/qpos"]
    for name in ("action", "observations/qpos"):
        file.create_dataset(name, (1 << 20, 512), "f4", chunks=(1 << 10, 512), compression="gzip")


def _without_steps(file: h5py.File) -> None:
    del file["action"], file["observations/qpos"]
    file["action"] = file["observations/qpos"] = np.zeros((0, 14))


def _unwritten(file: h5py.File) -> None:
    del file["action"], file["observations/qpos"]
    for name in ("action", "observations/qpos"):
        file.create_dataset(name, (3 << 20, 14), "f4", chunks=(1 << 14, 14))


def _named_again(place: str, count: int) -> Callable[[h5py.File], None]:
    """Return what gives a dataset many names, each of which costs a few bytes."""

    def change(file: h5py.File) -> None:
        file["observations/images/top"] = np.zeros((5, 16, 16, 3), "u1")
        for number in range(count):
            file[f"{place}_{number}"] = file[place]

    return change


def _one_image(path: Path, steps: int = 5000) -> None:
    """Write an episode whose images, of variable length, are all the first one: references to one place of the heap."""
    _hdf5(lambda file: file.clear())(path)
    image = np.frombuffer(datasets.jpeg(datasets.picture(0)) + bytes(100_000), np.uint8)
    with h5py.File(path / "episode_0.hdf5", "a") as file:
        file["action"] = file["observations/qpos"] = np.zeros((steps, 1), "f4")
        images = file.create_dataset("observations/images/top", (steps,), h5py.vlen_dtype(np.uint8))
        images[0] = image
        file.flush()
        first = images.id.get_offset()
    data = bytearray((path / "episode_0.hdf5").read_bytes())
    data[first : first + 16 * steps] = data[first : first + 16] * steps
    (path / "episode_0.hdf5").write_bytes(data)


def _images(*sizes: tuple[int, int]) -> Make:
    """Return what keeps an image of each size, and 100 of the last one."""
    rows = [datasets.jpeg(np.zeros((*size, 3), np.uint8)) for size in sizes]
    rows += rows[-1:] * 100

    def change(file: h5py.File) -> None:
        del file["action"], file["observations/qpos"]
        file["action"] = file["observations/qpos"] = np.zeros((len(rows), 14))
        file["observations/images/top"] = np.array(rows)

    return _hdf5(change)


def _dark(file: h5py.File) -> None:
    del file["action"], file["observations/qpos"]
    for name in ("action", "observations/qpos"):
        file.create_dataset(name, (100_000, 1), "f4", chunks=(1 << 14, 1))
    file.create_dataset("observations/images/top", (100_000, 512, 512, 3), "u1", chunks=(1, 512, 512, 3))


def _facts(path: Path) -> None:
    """Write 20 files that each say a million numbers beside the steps, in few bytes."""
    path.mkdir()
    for number in range(20):
        with h5py.File(path / f"episode_{number}.hdf5", "w") as file:
            file["action"] = file["observations/qpos"] = np.zeros((5, 14), "f4")
            file.create_dataset("fact", data=np.zeros(1 << 20), compression="gzip", chunks=(1 << 18,))


def _series(kind: Any) -> Make:
    """Return what writes the standard's form with a series of another kind than numbers."""

    def make(path: Path) -> None:
        path.mkdir()
        datasets.standard(path / "episode_0.hdf5")
        with h5py.File(path / "episode_0.hdf5", "a") as file:
            file.create_dataset("state/odd", (len(file["state/left_arm_joint_states"]), 6), kind)

    return make


def _demos(path: Path) -> None:
    with h5py.File(datasets.libero(path), "a") as file:
        file["data/demo_9"] = file["data/demo_0"]


def _rate(rate_hz: float) -> Make:
    return _hdf5(lambda file: file.attrs.__setitem__("fps", rate_hz))


HDF5: dict[str, Make] = {
    "no step": _hdf5(_without_steps),
    "steps that nobody wrote": _hdf5(_unwritten),
    "900 cameras that are one": _hdf5(_named_again("observations/images/top", 900)),
    "2,500 columns that are one": _hdf5(_named_again("action", 2500)),
    "images that are one": _one_image,
    "demos that are one": _demos,
    "images that nobody took": _hdf5(_dark),
    "millions of facts": _facts,
    "endless rate": _rate(float("inf")),
    "rate beyond clocks": _rate(1e308),
    "rate of a step a year": _rate(3e-8),
    "camera of 25 megapixels": _hdf5(
        lambda file: file.create_dataset("observations/images/top", (5, 5000, 5000, 3), "u1", chunks=(1, 50, 50, 3))
    ),
    "a series of bytes": _series("V8"),
    "a series of complex numbers": _series("c8"),
    "a series of records": _series(np.dtype([("x", "f4")])),
    "a series of lists": _series(h5py.vlen_dtype(np.float32)),
    "images that grow": _images((4, 4), (4000, 4000)),
    "images that turn": _images((64, 32), (32, 64)),
    "10 links by 12 levels": _hdf5(_web(10, 12)),
    "12 links by 8 levels": _hdf5(_web(12, 8)),
    "a group in itself": _hdf5(lambda file: file.create_group("own").__setitem__("own", file["own"])),
    "texts of a petabyte": _hdf5(_fixed((1 << 31) - 1, 1 << 19)),
    "a text for each step of 2 GB": _hdf5(_fixed((1 << 31) - 1, 5)),
    "rows of nothing": _hdf5(_zeros),
    "no steps": _hdf5(lambda file: file.__delitem__("action")),
}

# -- LeRobot -----------------------------------------------------------------------------------------------------------


def _info(**values: Any) -> Make:
    def make(path: Path) -> None:
        info = datasets.lerobot_v21(path) / "meta" / "info.json"
        info.write_text(json.dumps({**json.loads(info.read_text()), **values}))

    return make


def _episode(**values: Any) -> Make:
    def make(path: Path) -> None:
        listed = datasets.lerobot_v21(path) / "meta" / "episodes.jsonl"
        first, *others = listed.read_text().splitlines()
        listed.write_text("\n".join([json.dumps({**json.loads(first), **values}), *others]))

    return make


def _piped(which: str, write: Make) -> Make:
    """Return what puts a pipe in the place of a file, which nobody will write to."""

    def make(path: Path) -> None:
        write(path)
        file = min(path.glob(which))
        file.unlink()
        os.mkfifo(file)

    return make


def _without_a_column(path: Path) -> None:
    file = min(datasets.lerobot_v21(path).glob("data/*/*.parquet"))
    pq.write_table(pq.read_table(file).drop(["action"]), file)


def _listed(name: str, value: Callable[[int], int]) -> Make:
    """Return what changes a column of v3.0's table of episodes."""

    def make(path: Path) -> None:
        datasets.lerobot_v30(path)
        file = min(path.glob("meta/episodes/*/*.parquet"))
        table = pq.read_table(file)
        column = pa.array([value(number) for number in range(len(table))])
        pq.write_table(table.set_column(table.schema.get_field_index(name), name, column), file)

    return make


def _endless_list(path: Path) -> None:
    datasets.lerobot_v30(path)
    file = min(path.glob("meta/episodes/*/*.parquet"))
    pq.write_table(pq.read_table(file).take([0] * 100_000), file)


def _twice(path: Path) -> None:
    listed = datasets.lerobot_v21(path) / "meta" / "episodes.jsonl"
    listed.write_text(listed.read_text() * 2)


def _text(name: str, text: str) -> Make:
    return lambda path: (datasets.lerobot_v21(path) / "meta" / name).write_text(text)


CAMERA = "observation.images.front"
LEROBOT: dict[str, Make] = {
    "half a chunk": _info(chunks_size=0.5),
    "no chunk": _info(chunks_size=-1),
    "fps beyond floats": _info(fps=10**400),
    "fps of infinity": _info(fps=float("inf")),
    "features are none": _info(features=5),
    "a feature is none": _info(features={"action": 5}),
    "info of a feature": _info(features={CAMERA: {"dtype": "video", "shape": [4, 4, 3], "info": 5}}),
    "a shape beyond numbers": _info(features={"action": {"dtype": "float32", "shape": [10**30]}}),
    "a deep info": _text("info.json", '{"features":' + DEEP),
    "a deep episode": _text("episodes.jsonl", DEEP + "\n"),
    "an endless episode": _episode(length=float("inf")),
    "an empty episode": _episode(length=0),
    "a huge episode": _episode(length=10**30),
    "a long episode": _episode(length=1 << 30),
    "a far episode": _episode(episode_index=10**30),
    "tasks are none": _episode(tasks=5),
    "episodes listed twice": _twice,
    "all of one number": _listed("episode_index", lambda _: 0),
    "all of one row": _listed("dataset_from_index", lambda _: 0),
    "all of one file": _info(data_path="data/chunk-000/episode_000001.parquet"),
    "a list of 100,000 in no bytes": _endless_list,
    "a column is missing": _without_a_column,
    "a pipe of numbers": _piped("data/*/*.parquet", datasets.lerobot_v21),
    "a pipe of episodes": _piped("meta/episodes/*/*.parquet", datasets.lerobot_v30),
    "a pipe of images": _piped("videos/**/*.mp4", datasets.lerobot_v21),
}


def _odd_facts(file: h5py.File) -> None:
    kinds = np.dtype([("x", "f4"), ("y", "c8")])
    for number, value in enumerate((1 + 2j, np.longdouble(1), h5py.Empty("f4"), np.zeros(2, kinds), b"\xff")):
        file.attrs[f"fact{number}"] = value


HARMLESS: dict[str, Make] = {
    "facts that JSON has no form for": _hdf5(_odd_facts),
    "texts of 10 GB": _hdf5(_fixed(10_000, 1_000_000)),
    "a deep sentence": _hdf5(lambda file: file.attrs.__setitem__("instruction", DEEP[:60_000])),
    "a deep list of sentences": _hdf5(lambda file: file.create_dataset("instructions", data=DEEP)),
}
CASES = {**ZARR, **HDF5, **LEROBOT}


@pytest.mark.sampled(9)
@pytest.mark.parametrize("name", CASES)
def test_a_set_that_lies_is_one_error_in_bounded_memory(tmp_path: Path, name: str) -> None:
    """Its text names the set; neither this process nor the one that reads comes near a gigabyte."""
    path = tmp_path / "set"
    CASES[name](path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss  # of children that other tests started
    with pytest.raises(DataError, match=str(path)) as caught:
        everything(path)
    assert caught.value.code == ExitCode.FINDINGS
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500 << 10  # kB
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss < max(largest + 1, 700 << 10)


def test_an_index_beside_the_files_changes_no_length(tmp_path: Path) -> None:
    """The set tells the true length; whoever believes the index gets an error with the first step."""
    datasets.standard(tmp_path / "episode_0.hdf5")
    line = {"file": "episode_0.hdf5", "bytes": (tmp_path / "episode_0.hdf5").stat().st_size, "steps": 40}
    (tmp_path / "index.jsonl").write_text(json.dumps(line) + "\n")
    assert open_set(tmp_path)[0].length == 4
    with pytest.raises(TrajectoryError, match=r"episode_0\.hdf5 has another number of steps than 40"):
        open_folder(tmp_path)[0].observation(0)


def test_a_video_may_say_what_is_no_text(tmp_path: Path) -> None:
    path = datasets.lerobot_v21(tmp_path / "set")
    for file in path.glob("videos/**/*.mp4"):
        file.write_bytes(file.read_bytes().replace(b"Lavf", b"\xff\xfeav"))
    everything(path)


def test_sentences_beside_that_are_none_are_one_error(tmp_path: Path) -> None:
    path = datasets.robotwin(tmp_path / "set")
    for told in (5, {"seen": 5}, [5], {"unseen": [[]]}):
        (path / "instructions" / "episode0.json").write_text(json.dumps(told))
        with pytest.raises(DataError, match=r"instructions/episode0\.json"):
            everything(path)


@pytest.mark.parametrize("name", HARMLESS)
def test_what_is_odd_beside_the_steps_is_left_out_or_taken_as_text(tmp_path: Path, name: str) -> None:
    HARMLESS[name](tmp_path / "set")
    everything(tmp_path / "set")
    json.dumps(dict(open_set(tmp_path / "set")[0].extras))


def test_a_set_is_as_large_as_its_files(tmp_path: Path) -> None:
    """Links to one file, or to what has any size that the system makes up, allow it nothing."""
    folder = tmp_path / "set"
    (folder / "below").mkdir(parents=True)
    (folder / "below" / "file").write_bytes(os.urandom(100_000))
    for number in range(50):
        os.link(folder / "below" / "file", folder / f"again{number}")
        (folder / f"link{number}").symlink_to("below/file")
    for name, target in {"core": "/proc/kcore", "circle": "circle", "none": "nothing", "up": "..", "root": "/"}.items():
        (folder / name).symlink_to(target)
    assert ReadLimits.of(folder).size == 100_000


@pytest.mark.parametrize(
    ("take", "told"),
    [
        ("hog = bytearray(1 << 30)", "Memory"),
        ("while True: pass", "SIGXCPU"),
        ("import os; os.abort()", "SIGABRT"),
        ("path.with_suffix('.left').write_text('left')", "File too large"),
    ],
)
def test_a_reader_is_held_to_its_bounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, take: str, told: str) -> None:
    """Whatever a library does: it is ended, and the error says at what."""
    (tmp_path / "site").mkdir()
    code = f"def recognises(path):\n    return True\n\ndef opened(path):\n    {take}\n"
    (tmp_path / "site" / "greedy.py").write_text(code)
    folder = tmp_path / "site" / "greedy-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Name: greedy\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[xpl.formats]\ndata.greedy = greedy\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setattr(ReadLimits, "of", classmethod(lambda cls, _path: cls(64 << 20, 0.5)))
    (tmp_path / "set").mkdir()
    with pytest.raises((DataError, RuntimeError), match=told):
        open_set(tmp_path / "set")
    assert not any(file.read_text() for file in tmp_path.glob("*.left"))
