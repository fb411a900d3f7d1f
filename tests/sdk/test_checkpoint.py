from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from xpl import _spec as spec
from xpl.checkpoint import CheckpointError, resolve, resolve_step, run_name

RUN = {"bench_name": "RoboTwin", "ckpt_name": "demo", "env_cfg_type": "arx_x5", "action_type": "joint", "seed": 0}
RUN_FOLDER = "checkpoints/RoboTwin-demo-arx_x5-joint-0"


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    for name in ("given", "demo", RUN_FOLDER, "checkpoints/demo", "runs/demo"):
        (tmp_path / name).mkdir(parents=True)
    return tmp_path


@pytest.mark.parametrize("key", spec.CHECKPOINT_KEYS)
def test_an_explicit_path_comes_first(policy: Path, key: str) -> None:
    assert resolve({**RUN, key: "given"}, policy) == policy / "given"


def test_absolute_and_home_paths_are_kept(policy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(policy))
    assert resolve({"model_path": str(policy / "given")}, Path("/nowhere")) == policy / "given"
    assert resolve({"model_path": "~/given"}, Path("/nowhere")) == policy / "given"


def test_the_working_directory_plays_no_part(
    policy: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: Any
) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "only_here").mkdir()
    monkeypatch.chdir(elsewhere)
    assert resolve({"model_path": "given"}, policy) == policy / "given"
    with pytest.raises(CheckpointError):
        resolve({"model_path": "only_here"}, policy)


@pytest.mark.parametrize("key", spec.CHECKPOINT_KEYS)
def test_an_explicit_path_that_is_missing_is_an_error(policy: Path, key: str) -> None:
    with pytest.raises(CheckpointError, match=f"{key} is 'missing'.*does not exist"):
        resolve({**RUN, key: "missing"}, policy)


def test_the_name_as_a_path_comes_second(policy: Path) -> None:
    assert resolve({**RUN, "ckpt_name": "runs/demo"}, policy) == policy / "runs/demo"
    assert resolve(RUN, policy) == policy / "demo"
    for missing in ("./runs/other", "runs/other", "~/nothing/there"):
        with pytest.raises(CheckpointError, match="is the path"):
            resolve({**RUN, "ckpt_name": missing}, policy)


def test_the_conventional_run_comes_third_and_the_folder_of_the_name_last(policy: Path) -> None:
    (policy / "demo").rmdir()
    assert resolve(RUN, policy) == policy / RUN_FOLDER
    (policy / RUN_FOLDER).rmdir()
    assert resolve(RUN, policy) == policy / "checkpoints/demo"
    (policy / "checkpoints/demo").rmdir()
    with pytest.raises(CheckpointError) as missing:
        resolve(RUN, policy)
    assert all(name in str(missing.value) for name in (RUN_FOLDER, "checkpoints/demo"))


def test_seed_zero_is_part_of_a_run_name() -> None:
    assert run_name(RUN) == "RoboTwin-demo-arx_x5-joint-0"
    aliased = {**RUN, "bench_name": None, "dataset_name": "other"}
    assert run_name(aliased) == "other-demo-arx_x5-joint-0"
    assert run_name({**RUN, "dataset_name": "other"}) == "RoboTwin-demo-arx_x5-joint-0"
    assert run_name({**RUN, "seed": None}) is None


@pytest.mark.parametrize("empty", [{}, {"ckpt_name": None}, {"ckpt_name": ""}, {"model_path": "", "ckpt_name": None}])
def test_nothing_given_is_an_error(policy: Path, empty: dict[str, Any]) -> None:
    """Both null and empty mean not given; the policy folder itself is never taken for a checkpoint."""
    with pytest.raises(CheckpointError, match="no checkpoint is configured"):
        resolve(empty, policy)


def test_a_number_is_a_name(policy: Path) -> None:
    """YAML reads `ckpt_name: 3000` as one."""
    (policy / "checkpoints/3000").mkdir()
    assert resolve({"ckpt_name": 3000}, policy) == policy / "checkpoints/3000"


@pytest.fixture
def steps(tmp_path: Path) -> Path:
    for name in ("step_0", "checkpoint-50000", "notes", "step_5_backup"):
        (tmp_path / name).mkdir()
    (tmp_path / "5.ckpt").touch()
    (tmp_path / "config.json").touch()
    return tmp_path


def test_a_step_is_found_by_its_number(steps: Path) -> None:
    assert resolve_step(steps, 0).name == "step_0"
    assert resolve_step(steps, 5).name == "5.ckpt"
    assert resolve_step(steps, 50000).name == "checkpoint-50000"
    assert resolve_step(steps, None).name == "checkpoint-50000"


@pytest.mark.parametrize("step", [1, 50, 500, 5000, 500000])
def test_a_missing_step_is_an_error_and_never_another_step(steps: Path, step: int) -> None:
    with pytest.raises(CheckpointError, match="there are: 0, 5, 50000"):
        resolve_step(steps, step)


def test_two_entries_of_one_step_are_an_error(steps: Path) -> None:
    (steps / "step_5").mkdir()
    with pytest.raises(CheckpointError, match=r"several entries of step 5: 5\.ckpt, step_5"):
        resolve_step(steps, 5)
    assert resolve_step(steps, 0).name == "step_0"


@pytest.mark.parametrize("name", ["missing", "config.json", "notes"])
def test_a_folder_without_steps_is_an_error(steps: Path, name: str) -> None:
    with pytest.raises(CheckpointError, match="there are: none"):
        resolve_step(steps / name, None)


def test_the_pattern_is_the_callers(steps: Path) -> None:
    assert resolve_step(steps, 5, r"step_(\d+)_backup").name == "step_5_backup"
