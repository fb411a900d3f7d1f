from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest

from tests.data import made
from xpl_cli.data.formats import open_set
from xpl_cli.data.formats.lerobot import layout
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Converted = Callable[..., Any]


def test_a_part_of_an_episode_is_the_same_part_of_all_of_it(libero: Path, tmp_path: Path, converted: Converted) -> None:
    """Rows and frames by start and stop, from videos and from tables, are those of the whole."""
    converted(libero, tmp_path / "set", "lerobot-v3.0", codec="h264")
    episode = open_set(tmp_path / "set")[1]
    np.testing.assert_array_equal(episode.read("action", 2, 5), episode.read("action")[2:5])
    frames = list(episode.frames("observation.images.agentview_rgb"))
    part = list(episode.frames("observation.images.agentview_rgb", 3, 6))
    np.testing.assert_array_equal(part, frames[3:6])
    assert episode.read("action", 4, 4).shape == (0, 7)
    with pytest.raises(KeyError):
        episode.read("nobody")


def test_a_folder_of_tasks_is_one_set(tmp_path: Path) -> None:
    """Episodes of all files have keys of their own, in the order in which people count."""
    for name in ("bowl", "plate"):
        made.libero(tmp_path / f"{name}_demo.hdf5", episodes=2)
    found = open_set(tmp_path)
    assert [found[index].key for index in range(len(found))] == [
        f"{name}_demo/demo_{index}" for name in ("bowl", "plate") for index in range(2)
    ]


def test_jpegs_without_a_mark_are_rgb_in_the_standards_form_alone(tmp_path: Path) -> None:
    """A file of RoboDojo is read in true colours; any other format gives what its files hold."""
    rows = [made.jpeg(made.picture(step)[..., ::-1]) for step in range(3)]
    with h5py.File(tmp_path / "episode.hdf5", "w") as file:
        file["state/left_arm_joint_states"] = np.zeros((3, 6))
        file["action/left_arm_joint_states"] = np.zeros((3, 6))
        file.create_dataset("vision/cam_head/colors", data=rows, dtype=f"S{max(map(len, rows))}")
    image = next(open_set(tmp_path)[0].frames("vision/cam_head/colors")).astype(int)
    assert image[0, :, 0].mean() > 200
    assert image[0, :, 2].mean() < 60


@pytest.mark.parametrize("damage", ["truncated", "nothing", "text", "link", "outside", "huge"])
def test_a_damaged_file_is_one_sentence(damage: str, tmp_path: Path) -> None:
    """Whatever is wrong, and whatever a file names elsewhere, ends as DataError that names the file."""
    path = made.libero(tmp_path / "set.hdf5", episodes=1)
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:2000])
    elif damage == "nothing":
        path.write_bytes(b"")
    elif damage == "text":
        path.write_text("episodes", encoding="utf-8")
    else:
        with h5py.File(path, "a") as file:
            if damage == "link":
                file["data/demo_0/obs/other"] = h5py.ExternalLink("/etc/passwd", "/")
            elif damage == "outside":
                file.create_dataset("data/demo_0/obs/other", (8,), "u1", external=[("/etc/passwd", 0, 8)])
            else:
                file.create_dataset("data/demo_0/obs/other", (8, 1 << 40), "u1", chunks=(1, 1 << 20))
    with pytest.raises(DataError, match=r"set\.hdf5"):
        made.numbers(open_set(path)[0])


@pytest.mark.parametrize(
    "path",
    ["/etc/{video_key}", "../{video_key}.mp4", "{video_key.__class__}", "{nobody}", "videos/{video_key}/../../x"],
)
def test_paths_of_a_dataset_stay_in_it(path: str) -> None:
    """Templates of info.json are filled with names and numbers, and lead nowhere else."""
    with pytest.raises(DataError):
        layout.filled(path, {"video_key": "top"})


def test_a_video_that_is_shorter_than_its_episode_is_said(tmp_path: Path) -> None:
    """The error names the video and the first frame that is missing."""
    made.lerobot_v21(tmp_path / "set")
    first, _, last = sorted((tmp_path / "set" / "videos").rglob("*.mp4"))
    last.write_bytes(first.read_bytes())  # five frames, where seven are expected
    episode = open_set(tmp_path / "set")[2]
    with pytest.raises(DataError, match=r"episode_000002\.mp4 has no frame 5"):
        list(episode.frames("observation.images.top"))


def test_numbers_that_do_not_fit_their_description_are_refused(tmp_path: Path) -> None:
    """Where info.json promises another shape than the table has, nothing is guessed."""
    made.lerobot_v21(tmp_path / "set")
    path = tmp_path / "set" / "meta" / "info.json"
    info = json.loads(path.read_text(encoding="utf-8"))
    info["features"]["action"]["shape"] = [9]
    path.write_text(json.dumps(info), encoding="utf-8")
    with pytest.raises(DataError, match=r"action holds 35"):
        open_set(tmp_path / "set")[0].read("action")


def test_an_image_that_claims_too_much_is_refused(tmp_path: Path) -> None:
    """A PNG of a few bytes that says it has a billion pixels takes no memory."""
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBBI", 13, b"IHDR", 40_000, 40_000, 8, 2, 0, 0, 0, 0)
    with h5py.File(tmp_path / "episode.hdf5", "w") as file:
        file["action"] = np.zeros((2, 14))
        file["observations/qpos"] = np.zeros((2, 14))
        file.create_dataset("observations/images/top", data=[header + b"x", header + b"x"], dtype="S64")
    with pytest.raises(DataError, match="pixels"):
        open_set(tmp_path)[0].cameras  # noqa: B018 - asking is what is tested


def test_rlds_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without tensorflow-datasets a prepared set is recognised, and one sentence says what reads it."""
    monkeypatch.setitem(__import__("sys").modules, "tensorflow_datasets", None)
    for name in ("dataset_info.json", "features.json"):
        (tmp_path / name).write_text("{}", encoding="utf-8")
    with pytest.raises(DataError, match="tensorflow-datasets"):
        open_set(tmp_path)
