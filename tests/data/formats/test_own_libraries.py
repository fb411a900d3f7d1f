"""Each format in a small file made by its own library: what is read is what was written, or one sentence says why not.

LeRobot's v2.1 and v3.0 (pyarrow, av), robomimic's, ACT's, RoboTwin's and the standard's HDF5 (h5py), Diffusion
Policy's (zarr). RLDS has a test of its own, for its library needs a Python of its own.
"""

from __future__ import annotations

import functools
import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr

from tests.data import datasets
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.formats import image_files
from xpl_cli.data.reading import open_set
from xpl_cli.data.sets.errors import DataError

LOSSY_DB = 33.0
WRIST = "observation.images.wrist"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"


# -- what is written is read -------------------------------------------------------------------------------------------


def test_aloha(tmp_path: Path) -> None:
    """Numbers, raw images and padded JPEGs, the rate and the sentence of attributes."""
    qpos, action, frames = datasets.aloha(tmp_path / "episode_0.hdf5")
    dataset = open_set(tmp_path)
    (episode,) = (dataset[index] for index in range(len(dataset)))
    assert (dataset.format, dataset.rate_hz, episode.instructions) == ("aloha", 50.0, (datasets.SENTENCE,))
    np.testing.assert_array_equal(episode.read("observations/qpos"), qpos)
    np.testing.assert_array_equal(episode.read("action", 1, 3), action[1:3])
    np.testing.assert_array_equal(list(episode.frames("observations/images/top")), frames)
    assert episode.cameras["observations/images/wrist"].encoding == "jpeg"
    for shown, frame in zip(episode.frames("observations/images/wrist"), frames, strict=True):
        assert image_files.psnr(shown, frame) > LOSSY_DB


def test_robomimic(tmp_path: Path) -> None:
    """Numbers and images of each demonstration, the sentence, the robot and the rate of attributes."""
    path = datasets.libero(tmp_path / "bowl_demo.hdf5")
    dataset = open_set(path)
    assert (dataset.format, dataset.rate_hz, dataset.robot, len(dataset)) == ("robomimic", 20.0, "Panda", 3)
    for index in range(3):
        episode = dataset[index]
        with h5py.File(path) as file:
            group = file[f"data/demo_{index}"]
            actions, images = group["actions"][:], group["obs/agentview_rgb"][:]
        assert episode.instructions == (datasets.SENTENCE,)
        np.testing.assert_array_equal(episode.read("actions"), actions)
        np.testing.assert_array_equal(list(episode.frames("obs/agentview_rgb")), images)


def test_robotwin(tmp_path: Path) -> None:
    """Numbers, matrices of a camera, JPEGs as they lie there, and sentences of the file beside."""
    datasets.robotwin(tmp_path)
    episode = open_set(tmp_path)[0]
    with h5py.File(tmp_path / "data" / "episode0.hdf5") as file:
        vector = file["joint_action/vector"][:]
    np.testing.assert_array_equal(episode.read("joint_action/vector"), vector)
    camera = episode.cameras["observation/head_camera/rgb"]
    assert camera.intrinsics is not None
    assert camera.intrinsics.shape == (6, 3, 3)
    first = next(episode.frames("observation/head_camera/rgb"))
    assert image_files.psnr(first, datasets.picture(0)[..., ::-1]) > LOSSY_DB
    assert len(episode.instructions) == 3


@pytest.mark.parametrize("packed", [False, True])
def test_diffusion_policy(tmp_path: Path, packed: bool) -> None:
    """Rows between the ends of episodes, from a folder or a ZIP file; images of floats are those of Push-T."""
    action, images = datasets.diffusion_policy(tmp_path / "replay.zarr")
    path = tmp_path / "replay.zarr"
    if packed:
        path = Path(shutil.make_archive(str(tmp_path / "replay.zarr"), "zip", path))
    dataset = open_set(path)
    assert (dataset.format, len(dataset), dataset.rate_hz, dataset.robot) == ("diffusion-policy", 2, None, None)
    for index, part in enumerate((slice(0, 4), slice(4, 9))):
        episode = dataset[index]
        np.testing.assert_array_equal(episode.read("action"), action[part])
        np.testing.assert_array_equal(episode.read("action", 1, 3), action[part][1:3])
        np.testing.assert_array_equal(list(episode.frames("img")), images[part])
        np.testing.assert_array_equal(list(episode.frames("img_float")), images[part])


def test_lerobot_v21(tmp_path: Path) -> None:
    """Numbers of tables, frames of videos, lists of JSON lines."""
    datasets.lerobot_v21(tmp_path)
    dataset = open_set(tmp_path)
    assert (dataset.format, dataset.rate_hz, dataset.robot, len(dataset)) == ("lerobot-v2.1", 10.0, "panda", 3)
    for index in range(3):
        episode = dataset[index]
        table = pq.read_table(tmp_path / "data/chunk-000" / f"episode_{index:06d}.parquet")
        np.testing.assert_array_equal(episode.read("action"), table["action"].to_pylist())
        np.testing.assert_array_equal(episode.read("task_index"), table["task_index"])
        assert episode.instructions == (datasets.SENTENCE,)
        for step, frame in enumerate(episode.frames("observation.images.top")):
            assert image_files.psnr(frame, datasets.picture(step)) > LOSSY_DB


def test_lerobot_v30(tmp_path: Path) -> None:
    """Two episodes in one table and one video: each gets its own rows, frames and images, with the names of numbers."""
    actions, frames = datasets.lerobot_v30(tmp_path)
    dataset = open_set(tmp_path)
    assert (dataset.format, dataset.rate_hz, len(dataset)) == ("lerobot-v3.0", 10.0, 2)
    for index, part in enumerate((slice(0, 4), slice(4, 10))):
        episode = dataset[index]
        assert (episode.length, episode.instructions) == (part.stop - part.start, (datasets.SENTENCE,))
        assert episode.columns["action"].names[-1] == "joint_6"
        np.testing.assert_array_equal(episode.read("action"), actions[part])
        np.testing.assert_array_equal(list(episode.frames("observation.images.wrist")), frames[part])
        for shown, frame in zip(episode.frames("observation.images.top"), frames[part], strict=True):
            assert image_files.psnr(shown, frame) > LOSSY_DB


# -- what is damaged is one sentence -----------------------------------------------------------------------------------


def _everything(path: Path) -> None:
    dataset = open_set(path)
    for index in range(len(dataset)):
        dataset[index].instructions  # noqa: B018 - asking is what is tested
        datasets.numbers(dataset[index])
        for name in dataset[index].cameras:
            list(dataset[index].frames(name))


def _truncated(name: str) -> Callable[[Path], Any]:
    def damage(folder: Path) -> None:
        path = folder / name
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])

    return damage


def _hdf5(name: str, change: Callable[[Any], Any]) -> Callable[[Path], Any]:
    def damage(folder: Path) -> None:
        with h5py.File(folder / name, "a") as file:
            change(file)

    return damage


def _without(name: str, key: str) -> Callable[[Path], Any]:
    return _hdf5(name, lambda file: file.pop(key))


def _link(place: str, to: Any = None) -> Callable[[Path], Any]:
    """A set is what lies in its files: nothing is read through a link, wherever it leads."""

    def damage(folder: Path) -> None:
        shutil.copy(folder / "set.hdf5", folder.parent / "other.hdf5")
        with h5py.File(folder / "set.hdf5", "a") as file:
            if place in file:
                del file[place]
            file[place] = to or h5py.ExternalLink("../other.hdf5", place)

    return damage


def _other(name: str, shape: tuple[int, ...], **how: Any) -> Callable[[Path], Any]:
    return _hdf5("set.hdf5", lambda file: file.create_dataset(f"data/demo_0/obs/{name}", shape, "u1", **how))


def _replaced(name: str, content: bytes) -> Callable[[Path], Any]:
    return lambda folder: (folder / name).write_bytes(content)


def _info(**change: Any) -> Callable[[Path], Any]:
    def damage(folder: Path) -> None:
        path = folder / "meta" / "info.json"
        told = json.loads(path.read_text())
        if shape := change.pop("shape", None):
            told["features"]["action"]["shape"] = shape
        told |= change
        path.write_text(json.dumps({key: value for key, value in told.items() if value is not None}))

    return damage


def _shorter(folder: Path) -> None:
    first, _, last = sorted((folder / "videos").rglob("*.mp4"))
    last.write_bytes(first.read_bytes())  # five frames, where seven are expected


def _unlisted(folder: Path) -> None:
    path = folder / "meta" / "episodes.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    path.write_text("".join(json.dumps({k: v for k, v in line.items() if k != "length"}) + "\n" for line in lines))


def _uncolumn(name: str, column: str) -> Callable[[Path], Any]:
    def damage(folder: Path) -> None:
        pq.write_table(pq.read_table(folder / name).drop_columns([column]), folder / name)

    return damage


def _unended(folder: Path) -> None:
    shutil.rmtree(folder / "meta" / "episode_ends")
    (folder / "meta" / "episode_ends").mkdir()


def _falling(folder: Path) -> None:
    zarr.open_group(str(folder), mode="a")["meta/episode_ends"][:] = [9, 4]


def _short(folder: Path) -> None:
    zarr.open_group(str(folder), mode="a")["data/action"].resize((7, 2))


def _bomb(folder: Path) -> None:
    """Write a PNG of a few bytes that says it has a billion pixels."""
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBBI", 13, b"IHDR", 40_000, 40_000, 8, 2, 0, 0, 0, 0)
    with h5py.File(folder / "set.hdf5", "a") as file:
        del file["observations/images/top"]
        file.create_dataset("observations/images/top", data=[header + b"x"] * 4, dtype="S64")


LINKS = (None, h5py.SoftLink("/elsewhere"))
MAKERS: dict[str, Callable[[Path], Any]] = {
    "robomimic": lambda folder: datasets.libero(folder / "set.hdf5"),
    "aloha": lambda folder: datasets.aloha(folder / "set.hdf5"),
    "robotwin": datasets.robotwin,
    "xpl": lambda folder: datasets.standard(folder / "set.hdf5"),
    "zarr": datasets.diffusion_policy,
    "lerobot": datasets.lerobot_v21,
    "lerobot v3.0": datasets.lerobot_v30,
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a function that makes a set by its own library once, and finds that all of it can be read."""

    @functools.cache
    def make(maker: str) -> Path:
        folder = tmp_path_factory.mktemp("whole") / "set"
        if maker != "robotwin":
            folder.mkdir()
        MAKERS[maker](folder)
        _everything(folder)
        return folder

    return make


@pytest.mark.parametrize(
    ("maker", "damage", "told"),
    [
        *((maker, _truncated("set.hdf5"), ("set.hdf5",)) for maker in ("robomimic", "aloha", "xpl")),
        *(("robomimic", _replaced("set.hdf5", content), ("set.hdf5",)) for content in (b"", b"episodes")),
        *(("robomimic", _link(place, to), ("set.hdf5",)) for place in ("data", "data/demo_0") for to in LINKS),
        ("robomimic", _link("data/demo_0/obs/other", h5py.ExternalLink("/etc/passwd", "/")), ("set.hdf5",)),
        ("robomimic", _other("outside", (8,), external=[("/etc/passwd", 0, 8)]), ("set.hdf5",)),
        ("robomimic", _other("huge", (8, 1 << 40), chunks=(1, 1 << 20)), ("set.hdf5",)),
        ("aloha", _bomb, ("set.hdf5", "pixels")),
        ("robotwin", _truncated("data/episode0.hdf5"), ("episode0.hdf5",)),
        ("robotwin", _truncated("instructions/episode0.json"), ("episode0.json", "JSON")),
        ("robomimic", _without("set.hdf5", "data/demo_1/actions"), ("set.hdf5, demo_1", "actions or states")),
        ("robotwin", _without("data/episode0.hdf5", "joint_action/vector"), ()),
        ("xpl", _without("set.hdf5", "state"), ("set.hdf5", "unknown format", "action")),
        ("aloha", _without("set.hdf5", "action"), ("set.hdf5", "unknown format", "observations")),
        ("lerobot", _truncated("meta/info.json"), ("info.json", "JSON")),
        ("lerobot", _info(fps=None), ("info.json", "fps")),
        ("lerobot", _info(features=None), ("info.json", "features")),
        ("lerobot", _info(codebase_version="v9"), ("info.json", "v9")),
        ("lerobot", _info(data_path=None), ("data_path",)),
        ("lerobot", _info(shape=[9]), ("action holds 35",)),
        ("lerobot", _shorter, ("episode_000002.mp4 has no frame 5",)),
        ("lerobot", _unlisted, ("meta/", "length")),
        ("lerobot", _uncolumn("data/chunk-000/episode_000000.parquet", "action"), ("episode_000000.parquet", "action")),
        ("lerobot", _truncated("data/chunk-000/episode_000001.parquet"), ("episode_000001.parquet", "parquet")),
        (
            "lerobot",
            _truncated("videos/chunk-000/observation.images.top/episode_000002.mp4"),
            ("episode_000002.mp4",),
        ),
        ("lerobot", lambda folder: (folder / "data/chunk-000/episode_000002.parquet").unlink(), ("000002.parquet",)),
        (
            "lerobot v3.0",
            _truncated("meta/episodes/chunk-000/file-000.parquet"),
            ("episodes/chunk-000/file-000.parquet",),
        ),
        ("lerobot v3.0", _uncolumn("meta/episodes/chunk-000/file-000.parquet", "length"), ("meta/", "length")),
        ("lerobot v3.0", _uncolumn("data/chunk-000/file-000.parquet", WRIST), ("file-000.parquet", WRIST)),
        ("lerobot v3.0", _truncated("data/chunk-000/file-000.parquet"), ("data/chunk-000/file-000.parquet",)),
        ("lerobot v3.0", lambda folder: shutil.rmtree(folder / "videos"), ("no video", "file-000.mp4")),
        ("zarr", _unended, ("episode_ends",)),
        ("zarr", _falling, ("episode_ends", "non-decreasing")),
        ("zarr", _short, ("action has 3 of the rows 4 to 9",)),
        ("zarr", lambda folder: (folder / "data" / "img" / ".zarray").write_text("{"), ("zarr",)),
    ],
)
def test_what_is_damaged_is_one_sentence(
    maker: str,
    damage: Callable[[Path], Any],
    told: tuple[str, ...],
    tmp_path: Path,
    whole: Callable[[str], Path],
) -> None:
    """It names the file, and the key where one is missing; a column that need not be there is not missed."""
    folder = tmp_path / "set"
    shutil.copytree(whole(maker), folder)
    damage(folder)
    if not told:
        _everything(folder)
        return
    with pytest.raises(DataError) as caught:
        _everything(folder)
    assert all(word in str(caught.value) for word in told), str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.code == ExitCode.FINDINGS
