"""`xpl env`: what is listed, checked, drawn and filmed, as text and as JSON, and what is said of wrong names."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from xpl.manifest import Task
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.environments import check, rollout
from xpl_cli.main import app
from xpl_cli.packages import environments

pytest.importorskip("mujoco")

FOLDER = content_folder("envs") / "mujoco"
FACTS = environments.manifest(FOLDER).data
LIFT = ("--task", "lift_cube", "--embodiment", "franka_single", "--setting", "clean")


def _run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["env", *arguments])


# -- list --------------------------------------------------------------------------------------------------------------


def test_list_shows_what_is_offered() -> None:
    """People get tasks with instructions, machines the embodiments of each task and why others are missing."""
    answer = _run("list", "mujoco")
    assert answer.exit_code == 0
    assert all(task in answer.stdout for task in FACTS["tasks"])
    listed = json.loads(_run("list", "--json").stdout)
    assert listed["schema"] == "xpl.env-list/1"
    tasks = next(entry for entry in listed["environments"] if entry["name"] == "mujoco")["tasks"]
    for task, entry in FACTS["tasks"].items():
        why = {robot: rollout.unsupported(Task.parse(entry), robot) for robot in FACTS["embodiments"]}
        assert tasks[task]["embodiments"] == [robot for robot, reason in why.items() if reason is None]
        assert tasks[task]["unsupported"] == {robot: reason for robot, reason in why.items() if reason is not None}
        assert tasks[task]["stages"] == entry["stages"]


# -- check -------------------------------------------------------------------------------------------------------------


def test_check_prints_a_table() -> None:
    choice = ("--task", "handover_block", "--embodiment", "arx_x5", "--embodiment", "arx_x5_single")
    answer = _run("check", "mujoco", *choice, "--setting", "clean", "--episodes", "1", "--workers", "1")
    assert answer.exit_code == ExitCode.CLEAN, answer.output
    assert "1/1" in answer.stdout
    assert "not offered: for 2 arms" in answer.stdout
    assert "1 of 1 pass" in answer.stdout


@pytest.mark.slow
def test_check_reports_the_same_however_many_processes_play() -> None:
    """Episodes share nothing, and what comes back is put in order."""
    choice = (*LIFT, "--episodes", "11", "--json")
    reports = [_run("check", "mujoco", *choice, "--workers", workers) for workers in ("1", "2")]
    assert reports[0].stdout == reports[1].stdout
    report = json.loads(reports[0].stdout)
    assert report["schema"] == "xpl.env-check/1"
    assert report["ok"]
    (row,) = report["pairs"]
    assert (row["episodes"], row["expert"]["solved"], row["random"]["solved"]) == (11, 11, 0)
    assert row["expert"]["solved_seeds"] == check.seeds(FOLDER, "lift_cube", "clean")[:11]


def test_check_exits_with_findings_where_the_expert_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """The seed is named, not replaced; the file of seeds stays as it is."""
    before = {file.name: file.read_bytes() for file in (FOLDER / check.SEEDS).iterdir()}
    monkeypatch.setattr(rollout, "expert", lambda what: rollout.random_actions(what, 0))
    answer = _run("check", "mujoco", *LIFT, "--episodes", "1", "--workers", "1", "--json")
    assert answer.exit_code == ExitCode.FINDINGS
    report = json.loads(answer.stdout)
    assert not report["ok"]
    (failed,) = check.seeds(FOLDER, "lift_cube", "clean")[:1]
    assert report["pairs"][0]["expert"]["failed_seeds"] == [failed]
    assert f"expert fails on {failed}" in check.text(report)
    assert {file.name: file.read_bytes() for file in (FOLDER / check.SEEDS).iterdir()} == before


def test_check_says_what_is_missing() -> None:
    assert "no frozen seeds" in str(_run("check", "offline").exception)
    with pytest.raises(NotFoundError, match="names no expert"):
        rollout.expert(rollout.make_scenario("offline"))


# -- render, sheet and play --------------------------------------------------------------------------------------------


def test_render_writes_what_a_camera_sees(tmp_path: Path) -> None:
    """A PNG in the size of the manifest; the same bytes each time; another seed, another picture."""
    files = [tmp_path / f"{name}.png" for name in ("first", "again", "other")]
    for file, seed in zip(files, ("5", "5", "6"), strict=True):
        answer = _run("render", "mujoco", str(file), *LIFT, "--seed", seed, "--camera", "cam_head", "--json")
        assert answer.exit_code == 0, answer.output
        picture = json.loads(answer.stdout)
    first, again, other = (file.read_bytes() for file in files)
    assert first == again != other
    entry = FACTS["cameras"]["cam_head"]
    assert (picture["height"], picture["width"]) == (entry["height"], entry["width"])
    assert picture["instruction"] == FACTS["tasks"]["lift_cube"]["instruction"]
    with Image.open(files[0]) as image:
        assert image.size == (entry["width"], entry["height"])
        assert np.asarray(image).std() > 10


def test_sheet_shows_every_task_that_is_offered(tmp_path: Path) -> None:
    out = tmp_path / "sheet.png"
    answer = _run("sheet", "mujoco", str(out), "--embodiment", "franka_single", "--json")
    assert answer.exit_code == 0, answer.output
    picture = json.loads(answer.stdout)
    assert picture["task"] == [task for task, entry in FACTS["tasks"].items() if 1 in entry["arms"]]
    with Image.open(out) as image:
        assert image.size == (picture["width"], picture["height"])


def test_play_writes_a_film_that_moves(tmp_path: Path) -> None:
    """As long as the episode, whose end is told."""
    film = tmp_path / "lift.webp"
    answer = _run("play", "mujoco", str(film), *LIFT, "--seed", "100000", "--json")
    assert answer.exit_code == 0, answer.output
    result = json.loads(answer.stdout)["episode"]
    assert result["success"]
    with Image.open(film) as image:
        frames = image.n_frames  # type: ignore[attr-defined]
        assert frames == result["steps"] // 2 + 1
        first = np.asarray(image.convert("RGB")).astype(int)
        image.seek(frames - 1)
        assert np.abs(np.asarray(image.convert("RGB")).astype(int) - first).max() > 50
        assert image.info["duration"] == 2 * 1000 // FACTS["control_frequency"]


@pytest.mark.slow
def test_play_shows_random_actions_too(tmp_path: Path) -> None:
    """They end without success, and the film, of another format, is written all the same."""
    film = tmp_path / "random.gif"
    answer = _run("play", "mujoco", str(film), *LIFT, "--by", "random", "--camera", "cam_wrist", "--action-type", "ee")
    assert answer.exit_code == 0, answer.output
    assert "lift_cube: max_steps after 200 steps, score 0.00" in answer.stdout
    with Image.open(film) as image:
        assert (image.format, image.is_animated) == ("GIF", True)  # type: ignore[attr-defined]


# -- wrong names -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        (("check", "nowhere"), NotFoundError, "there is no environment 'nowhere'"),
        (("check", "mujoco", "--task", "lift_cub"), NotFoundError, "did you mean lift_cube"),
        (("check", "mujoco", "--embodiment", "arx"), NotFoundError, "there is no embodiment 'arx'"),
        (("check", "mujoco", "--setting", "random"), NotFoundError, "did you mean randomized"),
        (("check", "mujoco", "--action-type", "joints"), NotFoundError, "did you mean joint"),
        (("render", "mujoco", "{out}.png", "--camera", "cam_wrist"), NotFoundError, "did you mean cam_left_wrist"),
        (("render", "mujoco", "{out}.png", "--renderer", "ray"), NotFoundError, "there is no renderer 'ray'"),
        (("render", "offline", "{out}.png"), UserError, "draws nothing"),
        (("render", "mujoco", "{out}/deep.png"), UserError, "its folder does not exist"),
        (("sheet", "mujoco", "{out}.gif"), UserError, "must end in .png"),
        (("play", "mujoco", "{out}.gif", "--by", "experts"), NotFoundError, "did you mean expert"),
        (("play", "mujoco", "{out}.gif", "--task", "place_dual", "--embodiment", "piper_single"), UserError, "2"),
    ],
)
def test_what_there_is_not_is_refused_with_what_there_is(
    tmp_path: Path, arguments: tuple[str, ...], kind: type[Exception], message: str
) -> None:
    answer = _run(*(part.format(out=tmp_path / "out") for part in arguments))
    assert isinstance(answer.exception, kind)
    assert message in f"{answer.exception}; {getattr(answer.exception, 'hint', None)}"
    assert not list(tmp_path.iterdir())
