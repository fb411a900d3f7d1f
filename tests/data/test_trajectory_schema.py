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
from xpl_cli.data.sets import trajectory_schema

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
    path = _written(tmp_path / "episode.hdf5", form)
    assert trajectory_schema.schema_problems(path) == []


def _put(name: str, value: Any) -> Spoil:
    def spoil(file: Any) -> None:
        if name in file:
            del file[name]
        if value is not None:
            file[name] = value

    return spoil


def _without_images(file: Any) -> None:
    _put(COLORS, np.array([b"none"] * 3))(file)


def _without_names(file: Any) -> None:
    file.move("state", "old")
    file["state/qpos"] = np.zeros((3, 6))


COLORS = "vision/cam_head/colors"


@pytest.mark.parametrize(
    ("spoil", "path"),
    [
        (_put("state/left_ee_poses", np.zeros((2, 7))), "state/left_ee_poses"),
        (_put("action/left_ee_poses", np.zeros((3, 6))), "action/left_ee_poses"),
        (_put(COLORS, np.zeros((3, 8, 12), "f4")), COLORS),
        (_without_images, COLORS),
        (lambda file: file[COLORS].resize(2, 0), COLORS),
        (_put("vision/cam_head/depths", np.zeros((3, 8, 12), "u2")), "vision/cam_head/depths"),
        (_put("additional_info/frequency", "25"), "additional_info/frequency"),
        (_put("data_format_version", "v2"), "data_format_version"),
        (_put("instructions", "[]"), "instructions"),
        (_put("action", None), None),
        (_without_names, "state"),
    ],
)
def test_a_problem_names_its_dataset(tmp_path: Path, spoil: Spoil, path: str | None) -> None:
    file = _written(tmp_path / "episode.hdf5")
    with h5py.File(file, "r+") as opened:
        spoil(opened)
    (problem,) = trajectory_schema.schema_problems(file)
    assert (problem.file, problem.path) == (str(file), () if path is None else (path,))
    assert problem.missing == ("action" if path is None else None)


@pytest.mark.parametrize("rate", [float("nan"), float("inf")])
def test_a_number_that_is_none_is_a_problem(tmp_path: Path, rate: float) -> None:
    """It is within any bounds of a schema."""
    file = _written(tmp_path / "episode.hdf5")
    with h5py.File(file, "r+") as opened:
        _put("additional_info/frequency", rate)(opened)
    (problem,) = trajectory_schema.schema_problems(file)
    assert str(problem).endswith(f"additional_info/frequency: expected a number, got the text '{rate}'")


def test_a_file_that_is_none_of_hdf5_is_told_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "ep0.hdf5").write_bytes(b"spec: v1")
    ended = xpl("spec", "validate", tmp_path / "ep0.hdf5")
    assert ended.code == 4
    assert "cannot be read as HDF5" in ended.stderr
