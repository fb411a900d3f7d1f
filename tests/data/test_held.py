"""`xpl spec validate` of a trajectory: what differs from the schema is told with its dataset."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tests.support.commands import xpl
from xpl.trajectory import FORMS, Writer
from xpl_cli.data.sets import held

Spoil = Callable[[Any], None]


def _written(path: Path, form: str = FORMS[0]) -> Path:
    state = {"left_arm_joint_state": np.zeros(6, np.float32), "left_ee_pose": np.zeros(7, np.float32)}
    image = np.zeros((8, 12, 3), np.uint8)
    camera = {"color": image, "depth": np.ones((8, 12), np.float32), "intrinsic_matrix": np.eye(3), "shape": (8, 12)}
    with Writer(path, images=form, frequency=25, subtasks=[]) as writer:
        for _ in range(3):
            obs = {"instruction": "lift", "instructions": ["lift", "pick"], "vision": {"cam_head": camera}}
            writer.add({**obs, "state": state}, state, asked=True)
    return path


@pytest.mark.parametrize("form", FORMS)
def test_what_is_written_is_valid(tmp_path: Path, form: str) -> None:
    """In every form of images."""
    path = _written(tmp_path / "episode.hdf5", form)
    assert held.problems(path) == []


def _put(name: str, value: Any) -> Spoil:
    def spoil(file: Any) -> None:
        if name in file:
            del file[name]
        if value is not None:
            file[name] = value

    return spoil


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (_put("state/left_ee_poses", np.zeros((2, 7))), "state/left_ee_poses: expected (T, 7) numbers with T = 3"),
        (_put("action/left_ee_poses", np.zeros((3, 6))), "action/left_ee_poses: expected (T, 7) numbers"),
        (
            _put("vision/cam_head/colors", np.zeros((3, 8, 12), "f4")),
            "vision/cam_head/colors: expected (T, H, W, 3) uint8 or",
        ),
        (
            _put("vision/cam_head/depths", np.zeros((3, 8, 12), "u2")),
            "vision/cam_head/depths: expected (T, H, W) float",
        ),
        (_put("additional_info/frequency", "25"), "additional_info/frequency: expected a number, got the text '25'"),
        (_put("data_format_version", "v2"), "data_format_version: expected 'v1.0', got 'v2'"),
        (_put("instructions", "[]"), "instructions: expected a list of at least 1, got []"),
        (_put("action", None), "the key 'action' is missing"),
        (
            lambda file: file["vision/cam_head/colors"].resize(2, 0),
            "colors: expected 3 images, as many as there are steps",
        ),
        (
            _put("vision/cam_head/colors", np.array([b"none"] * 3)),
            "colors: expected an encoded image at step 0, got none",
        ),
        (
            lambda file: file.move("state", "old") or _put("state/qpos", np.zeros((3, 6)))(file),
            "state: no name of the standard",
        ),
    ],
)
def test_a_problem_names_its_dataset(tmp_path: Path, spoil: Spoil, told: str) -> None:
    """One for each thing that is wrong."""
    path = _written(tmp_path / "episode.hdf5")
    with h5py.File(path, "r+") as file:
        spoil(file)
    (problem,) = held.problems(path)
    assert told in str(problem)
    assert str(problem).startswith(str(path))


def test_a_file_that_is_none_of_hdf5_is_told_in_one_sentence(tmp_path: Path) -> None:
    """And no word about YAML."""
    (tmp_path / "ep0.hdf5").write_bytes(b"spec: v1")
    ended = xpl("spec", "validate", tmp_path / "ep0.hdf5")
    assert ended.code == 4
    assert "cannot be read as HDF5" in ended.stderr
