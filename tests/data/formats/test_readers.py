from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from tests.data import datasets
from xpl_cli.data.formats.lerobot import layout
from xpl_cli.data.reading import open_set
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path


def test_a_part_of_an_episode_is_the_same_part_of_all_of_it(tmp_path: Path) -> None:
    """Rows and frames by start and stop, from a video and from a table, are those of the whole."""
    datasets.lerobot_v30(tmp_path)
    episode = open_set(tmp_path)[1]
    np.testing.assert_array_equal(episode.read("action", 2, 5), episode.read("action")[2:5])
    for camera in episode.cameras:
        np.testing.assert_array_equal(list(episode.frames(camera, 3, 6)), list(episode.frames(camera))[3:6])
    assert episode.read("action", 4, 4).shape == (0, 7)
    with pytest.raises(KeyError):
        episode.read("nobody")


def test_a_folder_of_tasks_is_one_set(tmp_path: Path) -> None:
    """Episodes of all files have keys of their own, in the order in which people count."""
    for name in ("bowl", "plate"):
        datasets.libero(tmp_path / f"{name}_demo.hdf5", episodes=2)
    dataset = open_set(tmp_path)
    assert [dataset[index].key for index in range(len(dataset))] == [
        f"{name}_demo/demo_{index}" for name in ("bowl", "plate") for index in range(2)
    ]


def test_jpegs_without_a_mark_are_rgb_in_the_standards_form_alone(tmp_path: Path) -> None:
    """A file of RoboDojo is read in true colours; any other format gives what its files hold."""
    rows = [datasets.jpeg(datasets.picture(step)[..., ::-1]) for step in range(3)]
    with h5py.File(tmp_path / "episode.hdf5", "w") as file:
        file["state/left_arm_joint_states"] = np.zeros((3, 6))
        file["action/left_arm_joint_states"] = np.zeros((3, 6))
        file.create_dataset("vision/cam_head/colors", data=rows, dtype=f"S{max(map(len, rows))}")
    image = next(open_set(tmp_path)[0].frames("vision/cam_head/colors")).astype(int)
    assert image[0, :, 0].mean() > 200
    assert image[0, :, 2].mean() < 60


@pytest.mark.parametrize(
    "path",
    ["/etc/{video_key}", "../{video_key}.mp4", "{video_key.__class__}", "{nobody}", "videos/{video_key}/../../x"],
)
def test_paths_of_a_dataset_stay_in_it(path: str) -> None:
    """Templates of info.json are filled with names and numbers, and lead nowhere else."""
    with pytest.raises(DataError):
        layout.fill_path(path, {"video_key": "top"})


def test_rlds_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without tensorflow-datasets a prepared set is recognised, and one sentence says what reads it."""
    monkeypatch.setitem(sys.modules, "tensorflow_datasets", None)
    for name in ("dataset_info.json", "features.json"):
        (tmp_path / name).write_text("{}", encoding="utf-8")
    with pytest.raises(DataError, match="tensorflow-datasets"):
        open_set(tmp_path)
