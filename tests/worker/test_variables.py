"""Environment variables that policy.yml declares reach the processes that load its model."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import pytest

from xpl.variables import set_declared
from xpl_cli.standard.validate import validate

DECLARED = {"variables": {"AUTHORS_HOME": "{checkpoint}/home", "AUTHORS_THREADS": "1"}}


@pytest.fixture(autouse=True)
def _unset(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in DECLARED["variables"]:
        monkeypatch.setenv(name, "before")


def test_a_folder_of_the_checkpoint_is_named_where_it_has_one(tmp_path: Path) -> None:
    (tmp_path / "checkpoints" / "tiny" / "home").mkdir(parents=True)
    (tmp_path / "checkpoints" / "other").mkdir()
    set_declared(tmp_path, {"ckpt_name": "other"}, DECLARED)
    assert (os.environ["AUTHORS_HOME"], os.environ["AUTHORS_THREADS"]) == ("before", "1")
    set_declared(tmp_path, {"ckpt_name": "tiny"}, DECLARED)
    assert os.environ["AUTHORS_HOME"] == str(tmp_path / "checkpoints" / "tiny" / "home")


def test_what_libraries_compile_lies_in_the_cache_by_the_kind_of_processor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XPL_CACHE", str(tmp_path))
    set_declared(tmp_path, {}, {"variables": {"AUTHORS_HOME": "{cache}/jax"}})
    folder = Path(os.environ["AUTHORS_HOME"])
    assert folder.name == "jax"
    assert folder.parents[1] == tmp_path / "compiled"
    assert folder.parent.name.startswith(platform.machine())


def test_without_a_home_folder_a_cache_is_not_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError

    monkeypatch.setattr("xpl.user_cache.folder", homeless)
    set_declared(tmp_path, {}, {"variables": {"AUTHORS_HOME": "{cache}/jax"}})
    assert os.environ["AUTHORS_HOME"] == "before"


@pytest.mark.parametrize("environment", [None, {}, {"variables": None}, {"manager": "uv"}])
def test_without_a_declaration_nothing_changes(tmp_path: Path, environment: object) -> None:
    set_declared(tmp_path, {"ckpt_name": "tiny"}, environment)
    assert os.environ["AUTHORS_HOME"] == "before"


@pytest.mark.parametrize("name", ["PYTHONPATH", "LD_PRELOAD", "XPL_CACHE", "lower", "WITH-DASH"])
def test_variables_that_steer_the_interpreter_or_xpl_are_refused(name: str) -> None:
    manifest = {"spec": "v1", "environment": {"manager": "none", "variables": {name: "x"}}}
    assert [problem for problem in validate(manifest, "policy") if "variables" in str(problem)]


def test_a_tiny_checkpoint_runs_in_one_thread_unless_somebody_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.setenv("MKL_NUM_THREADS", "x")
    monkeypatch.delenv("MKL_NUM_THREADS")
    (tmp_path / "checkpoints" / "tiny").mkdir(parents=True)
    set_declared(tmp_path, {"ckpt_name": "tiny"}, None)
    assert "MKL_NUM_THREADS" not in os.environ
    (tmp_path / "checkpoints" / "tiny" / "tiny.json").write_text("{}")
    set_declared(tmp_path, {"ckpt_name": "tiny"}, None)
    assert (os.environ["OMP_NUM_THREADS"], os.environ["MKL_NUM_THREADS"]) == ("3", "1")
    monkeypatch.delenv("MKL_NUM_THREADS")
