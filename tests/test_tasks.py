"""Tasks of the MuJoCo environment and `xpl env`: solvable, not by chance, varied, frozen."""

import json
import re
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from xpl import get_embodiment
from xpl_cli import env_check, env_play
from xpl_cli.content import load_module, room
from xpl_cli.env_play import Scenario
from xpl_cli.errors import NotFoundError, UserError
from xpl_cli.main import app
from xpl_cli.progress import Progress

pytest.importorskip("mujoco")

FOLDER = room("envs") / "mujoco"
FACTS = load_module(FOLDER / "manifest.py").manifest()
TASKS = list(FACTS["tasks"])
SETTINGS = FACTS["settings"]
DIMENSIONS = {"generalisation", "precision", "long-horizon", "memory", "open"}
PAIRS = [
    (task, robot)
    for task, entry in FACTS["tasks"].items()
    for robot in FACTS["embodiments"]
    if env_check.unsupported(entry, robot) is None
]


def _run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["env", *arguments])


def _started(task: str, setting: str, seed: int, embodiment: str = "arx_x5") -> Any:
    env = env_play.make(Scenario("mujoco", task, embodiment, setting))
    env.reset([seed])
    return env


# -- declarations ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_a_task_declares_itself(task: str) -> None:
    """Dimension, stages that add up, a program, and other wordings than the instruction, each of them different."""
    entry = FACTS["tasks"][task]
    assert entry["dimension"] in DIMENSIONS
    assert sum(entry["stages"].values()) == pytest.approx(1.0)
    wordings = [entry["instruction"], *entry["paraphrases"]]
    assert len(set(wordings)) == len(wordings) >= 3
    names = {tuple(sorted(re.findall(r"{(\w+)}", wording))) for wording in wordings}
    assert len(names) == 1  # what is drawn is said in every wording
    assert (FOLDER / "tasks" / f"{task}.py").is_file()
    assert (room("policy") / "scripted_expert" / "programs" / f"{task}.py").is_file()


def test_every_dimension_has_a_task() -> None:
    """Generalisation, precision, long horizon, memory and open."""
    assert {entry["dimension"] for entry in FACTS["tasks"].values()} == DIMENSIONS


def test_a_pair_that_is_not_offered_says_why() -> None:
    """The reason stands in the manifest, and in the error of who asks all the same."""
    pairs = [(task, robot, why) for task in TASKS for robot, why in FACTS["tasks"][task].get("unsupported", {}).items()]
    for task, robot, why in pairs:
        assert robot in FACTS["embodiments"]
        with pytest.raises(UserError, match=re.escape(why)):
            env_play.make(Scenario("mujoco", task, robot, "clean"))


# -- experts and chance ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("setting", SETTINGS)
def test_frozen_seeds_are_solved_by_the_expert_and_not_by_chance(task: str, setting: str) -> None:
    """The first ones, with one embodiment; the slow tests and `xpl env check` play all."""
    report = env_check.check("mujoco", env_check.Choice([task], ["arx_x5"], [setting], 2), Progress())
    (row,) = report["pairs"]
    assert report["ok"], row
    assert row["expert"]["mean_score"] == 1.0
    assert row["expert"]["corrected_episodes"] == 0


@pytest.mark.slow
@pytest.mark.parametrize(("task", "embodiment"), PAIRS)
def test_all_frozen_seeds_hold(task: str, embodiment: str) -> None:
    """Every embodiment and setting that is offered."""
    report = env_check.check("mujoco", env_check.Choice([task], [embodiment]), Progress())
    assert report["ok"], env_check.text(report)


@pytest.mark.parametrize("task", TASKS)
def test_doing_nothing_earns_nothing(task: str) -> None:
    """No stage is reached by holding the first pose."""
    with closing(_started(task, "clean", 0)) as env:
        state = env.get_obs()["state"]
        action = {key: state[key] for key in get_embodiment("arx_x5").dims("joint")}
        while not env.is_episode_end():
            env.take_action(action)
        assert env.results()[0]["score"] == 0.0


@pytest.mark.parametrize("action_type", ["joint", "ee"])
def test_the_expert_plays_in_both_kinds_of_control(action_type: str) -> None:
    """The same program, through joint angles and through poses of the flange."""
    what = Scenario("mujoco", "stack_blocks_two", "arx_x5", "clean", action_type)
    result = env_play.play(env_play.make(what), env_play.expert(what), 100000)
    assert result["success"], result


# -- settings ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_randomized_changes_looks_and_words_and_not_the_layout(task: str) -> None:
    """The same seed: the task's own objects stay where they are on the table, which is another one."""
    seen = {setting: _started(task, setting, 11) for setting in SETTINGS}
    clean, varied = (seen[setting].get_obs() for setting in SETTINGS)
    assert varied["instruction"] != clean["instruction"]
    assert "{" not in clean["instruction"] + varied["instruction"]
    lower = clean["privileged"]["table_top"] - varied["privileged"]["table_top"]
    assert 0.0 <= lower <= FACTS["randomized"]["table_lower"]
    for name, entry in clean["privileged"]["objects"].items():
        other = varied["privileged"]["objects"][name]
        assert np.allclose(entry["pose"] - other["pose"], [0, 0, lower, 0, 0, 0, 0], atol=1e-3)
    looks = [env.render(0, "cam_head").astype(int) for env in seen.values()]
    assert np.abs(looks[0] - looks[1]).mean() > 3.0


def test_randomized_episodes_differ_and_repeat() -> None:
    """The seed decides what is drawn: words, table and light."""
    drawn = []
    for seed in (3, 3, 4, 5, 6):
        with closing(_started("lift_cube", "randomized", seed)) as env:
            obs = env.get_obs()
            drawn.append((obs["instruction"], obs["privileged"]["table_top"], env.render(0, "cam_head").tobytes()))
    assert drawn[0] == drawn[1]
    assert len({row[1] for row in drawn}) == 4
    assert len({row[0] for row in drawn}) > 1


# -- what is special about some tasks ----------------------------------------------------------------------------------


def test_the_instruction_names_the_block_that_counts() -> None:
    """Whoever lifts another one has failed; every color and place is asked for by some seed."""
    named = set()
    for seed in range(12):
        with closing(_started("pick_by_language", "clean", seed)) as env:
            obs = env.get_obs()
            named.add((obs["instruction"], obs["privileged"]["target"]))
    assert len({words for words, _ in named}) == 4
    assert len({target for _, target in named}) == 3

    what = Scenario("mujoco", "pick_by_language", "arx_x5", "clean")
    expert = env_play.expert(what)
    with closing(env_play.make(what)) as env:

        def misled(obs: Any) -> Any:
            names = sorted(obs["privileged"]["objects"])
            names.remove(obs["privileged"]["target"])
            return expert({**obs, "privileged": {**obs["privileged"], "target": names[0]}})

        result = env_play.play(env, misled, 100000)
    assert (result["success"], result["score"]) == (False, 0.0)


def test_memory_needs_what_is_seen_no_more() -> None:
    """The red cube is in the picture at first and in none later; a wrong cover cannot be made good."""
    what = Scenario("mujoco", "memory_cover", "arx_x5", "clean")
    with closing(_started("memory_cover", "clean", 100000)) as env:
        state = env.get_obs()["state"]
        hold = {key: state[key] for key in get_embodiment("arx_x5").dims("joint")}
        pictures = []
        for _ in range(40):
            pictures.append(env.render(0, "cam_head").astype(int))
            env.take_action(hold)
        red = [np.sum((image[..., 0] > 110) & (image[..., 1] < 70) & (image[..., 2] < 70)) for image in pictures]
        assert min(red[:20]) > 20
        assert red[-1] == 0
    expert = env_play.expert(what)
    with closing(env_play.make(what)) as env:

        def misled(obs: Any) -> Any:
            wrong = next(f"cover_{place}" for place in (1, 2, 3) if f"cover_{place}" != obs["privileged"]["target"])
            return expert({**obs, "privileged": {**obs["privileged"], "target": wrong}})

        assert not env_play.play(env, misled, 100000)["success"]


# -- seeds -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_seeds_are_frozen_for_every_setting(task: str) -> None:
    """Without repetition, apart for each setting; a first episode of a user (seed 0) is never one of them."""
    chosen = [env_check.seeds(FOLDER, task, setting) for setting in SETTINGS]
    for numbers in chosen:
        assert len(numbers) == len(set(numbers)) >= 20
        assert min(numbers) >= 100000
    assert not set(chosen[0]) & set(chosen[1])


def test_a_failing_seed_is_reported_and_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the expert fails, the check names the seed and exits with 1; the file stays as it is."""
    before = {file.name: file.read_bytes() for file in (FOLDER / "seeds").iterdir()}
    monkeypatch.setattr(env_play, "expert", lambda what: env_play.at_random(what, 0))
    answer = _run("check", "mujoco", "--task", "lift_cube", "--embodiment", "arx_x5", "--episodes", "1", "--json")
    assert answer.exit_code == 1
    row = json.loads(answer.stdout)["pairs"][0]
    assert row["expert"]["failed_seeds"] == env_check.seeds(FOLDER, "lift_cube", row["setting"])[:1]
    assert {file.name: file.read_bytes() for file in (FOLDER / "seeds").iterdir()} == before
    with pytest.raises(NotFoundError, match="no frozen seeds"):
        env_check.seeds(tmp_path, "lift_cube", "clean")


# -- the command -------------------------------------------------------------------------------------------------------


def test_env_list_shows_what_is_offered() -> None:
    """People get tasks with instructions, machines the embodiments of each task."""
    answer = _run("list", "mujoco")
    assert answer.exit_code == 0
    assert all(task in answer.stdout for task in TASKS)
    listed = json.loads(_run("list", "--json").stdout)
    assert listed["schema"] == "xpl.env-list/1"
    tasks = next(entry for entry in listed["environments"] if entry["name"] == "mujoco")["tasks"]
    assert {(task, robot) for task, entry in tasks.items() for robot in entry["embodiments"]} == set(PAIRS)


def test_env_check_prints_a_table() -> None:
    """A line for each pair, with the reason where one is not offered."""
    answer = _run("check", "mujoco", "--task", "handover_block", "--setting", "clean", "--episodes", "1",
                  "--embodiment", "arx_x5", "--embodiment", "arx_x5_single")  # fmt: skip
    assert answer.exit_code == 0, answer.stdout
    assert "1/1" in answer.stdout
    assert "not offered: for 2 arms" in answer.stdout
    assert "1 of 1 hold" in answer.stdout


def test_env_render_and_play_write_pictures(tmp_path: Path) -> None:
    """A PNG of the first frame, and a film that moves."""
    from PIL import Image

    picture, film = tmp_path / "first.png", tmp_path / "lift.webp"
    assert _run("render", "mujoco", str(picture), "--task", "lift_cube").exit_code == 0
    entry = FACTS["cameras"]["cam_third_view"]
    with Image.open(picture) as image:
        assert image.size == (entry["width"], entry["height"])
    answer = _run("play", "mujoco", str(film), "--task", "lift_cube", "--seed", "100000")
    assert answer.exit_code == 0
    assert "success" in answer.stdout
    with Image.open(film) as image:
        assert image.n_frames > 10  # type: ignore[attr-defined]


def test_a_wrong_name_is_one_sentence(tmp_path: Path) -> None:
    """Environment, task, camera, ending."""
    assert isinstance(_run("check", "nowhere").exception, NotFoundError)
    assert isinstance(_run("check", "mujoco", "--task", "fly").exception, NotFoundError)
    assert "did you mean" in str(_run("render", "mujoco", str(tmp_path / "a.png"), "--task", "lift_cub").exception)
    assert "camera" in str(_run("render", "mujoco", str(tmp_path / "a.png"), "--camera", "cam_foot").exception)
    assert ".gif" in str(_run("play", "mujoco", str(tmp_path / "a.avi")).exception)
