"""Sets that lie of what they were made of, or that no file can hold: a conversion is one error, and leaves nothing."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tests.data import datasets
from xpl_cli.basics.errors import ExitCode
from xpl_cli.basics.progress import Progress
from xpl_cli.data.conversion import job
from xpl_cli.data.formats.writing import WriteOptions
from xpl_cli.data.reading import open_set
from xpl_cli.data.sets.errors import DataError

Change = Callable[[dict[str, Any]], Any]


def convert(source: Path, target: Path, to: str = "xpl") -> None:
    images = "png" if to != "xpl" else "auto"
    job.convert(
        job.ConversionJob(source, target, to, rate_hz=10, options=WriteOptions(images=images), workers=1), Progress()
    )


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a LeRobot set that was made of one of the standard's, and says so."""
    folder = tmp_path_factory.mktemp("packed")
    datasets.standard(folder / "episode_0.hdf5")
    convert(folder / "episode_0.hdf5", folder / "set", "lerobot-v3.0")
    return folder / "set"


def _put(key: str, value: Any) -> Change:
    return lambda told: told.__setitem__(key, value)


LIES: dict[str, tuple[str, Change]] = {
    "a series that is none": ("packed series/state", _put("packed series", {"state": 5})),
    "a part that is none": ("packed series/action/0", _put("packed series", {"action": [5]})),
    "a part without a width": ("packed series/state/0", _put("packed series", {"state": [["a"]]})),
    "a width that is none": ("packed series/state/0/1", _put("packed series", {"state": [["a", [6]]]})),
    "names in a list": ("names", _put("names", ["a"])),
    "a name that is none": ("names/action", _put("names", {"action": []})),
    "numbers of anything": ("numbers/0", _put("numbers", [{}, None])),
    "a vector that is not there": ("a column no/such", _put("packed series", {"no/such": [["a", 1]]})),
    "another width": ("a column state with rows of 5", _put("packed series", {"state": [["state/x", 5]]})),
    "a part twice": ("of one name", _put("packed series", {"state": [["state/x", 3], ["state/x", 3]]})),
    "a camera for a vector": ("a column state", _put("names", {"observation.images.cam_head": "state"})),
    "two of one name": ("a column action", _put("names", {"observation.state": "state", "action": "state"})),
    "a part in a part": (
        "both state/x and state/x/y",
        _put("packed series", {"state": [["state/x", 3], ["state/x/y", 3]]}),
    ),
}


@pytest.mark.parametrize("name", LIES)
def test_what_a_set_says_of_its_origin_is_checked(tmp_path: Path, packed: Path, name: str) -> None:
    told, change = LIES[name]
    source, target = Path(shutil.copytree(packed, tmp_path / "set")), tmp_path / "made"
    info = source / "meta" / "info.json"
    document = json.loads(info.read_text())
    change(document["extras"]["converted"])
    info.write_text(json.dumps(document))
    with pytest.raises(DataError, match=told) as caught:
        convert(source, target)
    is_of_the_set = name != "a part in a part"  # which any names may be that HDF5 cannot keep
    assert not is_of_the_set or caught.value.code == ExitCode.FINDINGS
    assert not is_of_the_set or str(source) in str(caught.value)
    assert not target.exists()


def test_the_true_one_becomes_what_it_was(tmp_path: Path, packed: Path) -> None:
    convert(packed, tmp_path / "made")
    assert {"state/left_arm_joint_states", "action/left_arm_joint_states"} <= set(
        open_set(tmp_path / "made")[0].columns
    )


@pytest.mark.parametrize("name", ["observation.\x1b[2Jstate", "a\0b", "a//b", "../b", "", "b" * 300, "a\ud800"])
def test_a_name_that_is_none_is_one_error(tmp_path: Path, name: str) -> None:
    path = datasets.lerobot_v21(tmp_path / "set")
    info = json.loads((path / "meta" / "info.json").read_text())
    info["features"][name] = info["features"].pop("observation.state")
    (path / "meta" / "info.json").write_text(json.dumps(info))
    with pytest.raises(DataError, match=str(path)) as caught:
        convert(path, tmp_path / "made")
    assert caught.value.code == ExitCode.FINDINGS
    assert str(caught.value).isprintable()


def test_an_index_that_lies_changes_no_conversion(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    datasets.standard(tmp_path / "set" / "episode_0.hdf5")
    line = {"file": "episode_0.hdf5", "bytes": (tmp_path / "set" / "episode_0.hdf5").stat().st_size, "steps": 40}
    (tmp_path / "set" / "index.jsonl").write_text(json.dumps(line) + "\n")
    convert(tmp_path / "set", tmp_path / "made", "lerobot-v3.0")
    assert open_set(tmp_path / "made")[0].length == 4


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("instruction", "instruction: expected text, got an array"),
        ("subtasks", "subtasks: expected a list"),
        ("additional_info/frequency", "additional_info/frequency: expected a number, got an array"),
        ("vision/cam_head/intrinsic_matrix", "vision/cam_head/intrinsic_matrix: expected"),
        ("state/left_ee_poses", r"state/left_ee_poses: expected \(T, 7\) numbers"),
    ],
)
def test_what_the_standard_does_not_allow_is_not_written(tmp_path: Path, packed: Path, name: str, told: str) -> None:
    """A column gets any name that a set says it had, also one that means something else."""
    source, target = Path(shutil.copytree(packed, tmp_path / "set")), tmp_path / "made"
    info = source / "meta" / "info.json"
    document = json.loads(info.read_text())
    converted = document["extras"]["converted"]
    for vector, odd in (("state", name), ("action", "action/odd")):
        [[series, width]] = converted["packed series"][vector]
        converted["packed series"][vector] = [[odd, 2], [series, width - 2]]
    info.write_text(json.dumps(document))
    with pytest.raises(DataError, match=told):
        convert(source, target)
    assert not target.exists()


@pytest.mark.parametrize("value", [[[1], [1, 2, [3]]], [[["a"]]], [[None]]])
def test_a_matrix_of_a_camera_that_is_none_is_one_error(tmp_path: Path, value: Any) -> None:
    path = tmp_path / "episode_0.hdf5"
    datasets.standard(path)
    with h5py.File(path, "a") as file:
        file["additional_info/episode"] = json.dumps({"vision/cam_head/extrinsic_matrix": value})
    with pytest.raises(DataError, match="vision/cam_head/extrinsic_matrix"):
        convert(path, tmp_path / "made")
    assert not (tmp_path / "made").exists()


def test_facts_of_any_form_are_kept_or_refused_by_name(tmp_path: Path) -> None:
    """LeRobot keeps what stands beside the steps as JSON; the standard has a place for it, which takes numbers."""
    path = tmp_path / "episode_0.hdf5"
    datasets.standard(path)
    facts = {"vision/cam_head/shape": {"a": [None]}, "subtasks": 5, "robot": []}
    with h5py.File(path, "a") as file:
        file["additional_info/episode"] = json.dumps(facts)
        file["vision/cam_head/intrinsic_matrix"] = np.full((2, 2), np.nan)
        file["subtasks"] = "[5]"
    convert(path, tmp_path / "lerobot", "lerobot-v3.0")
    assert open_set(tmp_path / "lerobot")[0].length == 4
    with pytest.raises(DataError, match="episode_0: vision/cam_head/shape/a: expected numbers"):
        convert(path, tmp_path / "made")
