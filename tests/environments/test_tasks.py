"""Tasks of the MuJoCo environment: solvable, not by chance, varied, frozen."""

import re
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from xpl import _spec as spec
from xpl import get_embodiment
from xpl.manifest import Task
from xpl_cli.basics.content import content_folder, load_module
from xpl_cli.basics.errors import UserError
from xpl_cli.basics.progress import Progress
from xpl_cli.environments import check, rollout
from xpl_cli.environments.rollout import Scenario

pytest.importorskip("mujoco")

FOLDER = content_folder("envs") / "mujoco"
FACTS = load_module(FOLDER / "manifest.py").manifest().data
TASKS = list(FACTS["tasks"])
SETTINGS = FACTS["settings"]
BACKDROP = re.compile(r"table|floor|ceiling|wall_")
DIMENSIONS = {"generalisation", "precision", "long-horizon", "memory", "open"}
PAIRS = [
    (task, robot)
    for task, entry in FACTS["tasks"].items()
    for robot in FACTS["embodiments"]
    if check.unsupported(Task.parse(entry), robot) is None
]


def _started(task: str, setting: str, seed: int, embodiment: str = "arx_x5") -> Any:
    env = rollout.make(Scenario("mujoco", task, embodiment, setting))
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
    assert (content_folder("policy") / "scripted_expert" / "programs" / f"{task}.py").is_file()


def test_a_pair_that_is_not_offered_says_why() -> None:
    pairs = [(task, robot, why) for task in TASKS for robot, why in FACTS["tasks"][task].get("unsupported", {}).items()]
    for task, robot, why in pairs:
        assert robot in FACTS["embodiments"]
        with pytest.raises(UserError, match=re.escape(why)):
            rollout.make(Scenario("mujoco", task, robot, "clean"))


# -- experts and chance ------------------------------------------------------------------------------------------------


def test_frozen_seeds_are_solved_by_the_expert_and_not_by_chance() -> None:
    """Of one task; the slow tests play all of all tasks."""
    report = check.check("mujoco", check.CheckSelection(["lift_cube"], ["arx_x5"], episodes=1), Progress())
    assert [row["setting"] for row in report["pairs"]] == SETTINGS
    assert report["ok"], report["pairs"]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(("task", "embodiment"), PAIRS)
@pytest.mark.parametrize("action_type", spec.ACTION_TYPES)
def test_every_frozen_seed_is_solved_by_the_expert_and_not_by_chance(
    task: str, embodiment: str, action_type: str
) -> None:
    """Each seed once, shared among the embodiments and kinds of control that are offered; and two that are not frozen.

    All with all take two cores three hours, as `xpl env check mujoco`, which is run when the scene is changed.
    """
    ways = [(robot, control) for name, robot in PAIRS if name == task for control in spec.ACTION_TYPES]
    share = ways.index((embodiment, action_type))
    for setting in SETTINGS:
        numbers = check.seeds(FOLDER, task, setting)[share :: len(ways)]
        what = Scenario("mujoco", task, embodiment, setting, action_type)
        with closing(rollout.make(what)) as env:
            results = {seed: rollout.run_episode(env, rollout.expert(what), seed) for seed in (*numbers, 0, 1)}
            guessed = rollout.run_episode(env, rollout.random_actions(what, numbers[0]), numbers[0])
        assert [seed for seed, result in results.items() if not result["success"]] == []
        assert {result["score"] for result in results.values()} == {1.0}
        assert not guessed["success"]
        if (embodiment, action_type) == ("arx_x5", "joint"):
            assert not any(result["corrections"] for result in results.values())


@pytest.mark.sampled(1)
@pytest.mark.parametrize("task", TASKS)
def test_stages_come_in_order_and_success_must_hold(task: str) -> None:
    """The expert earns one after the other; the last when the goal has held for ten steps in a row, at rest."""
    what = Scenario("mujoco", task, "arx_x5", "clean")
    earned: list[str] = []
    steps_held = [0]
    with closing(rollout.make(what)) as env:

        def watch() -> None:
            earned.extend(name for name, done in env.results()[0]["stages"].items() if done and name not in earned)
            judge, physics = env.episodes[0]._task, env.episodes[0].physics
            steps_held.append(steps_held[-1] + 1 if judge.solved(physics) and judge._at_rest(physics) else 0)

        result = rollout.run_episode(env, rollout.expert(what), 100003, watch)
    assert earned == list(FACTS["tasks"][task]["stages"])
    assert result["score"] == 1.0
    assert steps_held[-1] == FACTS["success"]["hold_steps"] > max(steps_held[:-1])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("task", TASKS)
def test_doing_nothing_earns_nothing(task: str) -> None:
    with closing(_started(task, "clean", 0)) as env:
        state = env.get_obs()["state"]
        action = {key: state[key] for key in get_embodiment("arx_x5").dims("joint")}
        while not env.is_episode_end():
            env.take_action(action)
        assert env.results()[0]["score"] == 0.0


def test_the_expert_plays_in_poses_too() -> None:
    what = Scenario("mujoco", "stack_blocks_two", "arx_x5", "clean", "ee")
    result = rollout.run_episode(rollout.make(what), rollout.expert(what), 100000)
    assert result["success"], result


# -- settings ----------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(3)
@pytest.mark.parametrize("task", TASKS)
def test_randomized_changes_looks_and_words_and_not_the_layout(task: str) -> None:
    """The same seed: the task's own objects stay where they are on the table, which is another one."""
    observations = {setting: _started(task, setting, 11) for setting in SETTINGS}
    clean, varied = (observations[setting].get_obs() for setting in SETTINGS)
    assert varied["instruction"] != clean["instruction"]
    assert "{" not in clean["instruction"] + varied["instruction"]
    lower = clean["privileged"]["table_top"] - varied["privileged"]["table_top"]
    assert 0.0 <= lower <= FACTS["randomized"]["table_lower"]
    for name, entry in clean["privileged"]["objects"].items():
        other = varied["privileged"]["objects"][name]
        assert np.allclose(entry["pose"] - other["pose"], [0, 0, lower, 0, 0, 0, 0], atol=1e-3)
    looks = [env.render(0, "cam_head").astype(int) for env in observations.values()]
    assert np.abs(looks[0] - looks[1]).mean() > 3.0


@pytest.mark.sampled(3)
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("seed", [200003, 200006])
def test_nothing_stands_in_the_way_and_all_is_to_be_seen(task: str, seed: int) -> None:
    """Clutter and distractors keep clear of what the task needs, and nothing of it has the color of the table."""
    with closing(_started(task, "randomized", seed, "piper_x")) as env:
        physics, needs = env.episodes[0].physics, list(env.episodes[0]._task.clear)
    model, data = physics.model, physics.data
    added: dict[str, list[np.ndarray]] = {"clutter": [], "distractors": []}
    colors = []
    for index in range(model.ngeom):
        body, name = model.body(model.geom_bodyid[index]), model.geom(index).name
        kind = body.name.split("_")[0]
        if kind in added:
            added[kind].append(data.geom_xpos[index][:2])
        elif not re.match(r"(left|right)_", model.body(body.rootid[0]).name) and not BACKDROP.match(name):
            needs.append(data.geom_xpos[index][:2])
            colors.append(model.geom_rgba[index][:3])
    assert added["clutter"]
    assert added["distractors"]
    for kind, positions in added.items():
        apart = FACTS["randomized"][kind]["apart"] - 0.005  # they settle a little
        assert min(np.hypot(*(position - need)) for position in positions for need in needs) >= apart, kind
    table = model.geom("table").rgba[:3]
    assert min(np.linalg.norm(table - color) for color in colors) >= FACTS["randomized"]["table_contrast"] - 1e-6


def test_randomized_episodes_differ_and_repeat() -> None:
    drawn = []
    for seed in (3, 3, 4, 5, 6):
        with closing(_started("lift_cube", "randomized", seed)) as env:
            obs = env.get_obs()
            drawn.append((obs["instruction"], obs["privileged"]["table_top"], env.render(0, "cam_head").tobytes()))
    assert drawn[0] == drawn[1]
    assert len({row[1] for row in drawn}) == 4
    assert len({row[0] for row in drawn}) > 1


# -- what is special about some tasks ----------------------------------------------------------------------------------


@pytest.mark.slow
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
    expert = rollout.expert(what)
    with closing(rollout.make(what)) as env:

        def misled(obs: Any) -> Any:
            names = sorted(obs["privileged"]["objects"])
            names.remove(obs["privileged"]["target"])
            return expert({**obs, "privileged": {**obs["privileged"], "target": names[0]}})

        result = rollout.run_episode(env, misled, 100000)
    assert (result["success"], result["score"]) == (False, 0.0)


class _Naming(np.random.Generator):
    """Draws as any generator does, but always the same block to be named."""

    def __init__(self, seed: int, named: int) -> None:
        super().__init__(np.random.PCG64(seed))
        self._named = named

    def integers(self, *args: Any, **kwargs: Any) -> Any:
        super().integers(*args, **kwargs)
        return self._named


def test_only_the_words_tell_which_block_counts() -> None:
    scene_module, task_module = (load_module(FOLDER / f"{name}.py") for name in ("scene", "task"))
    robot, entry = get_embodiment("arx_x5"), FACTS["tasks"]["pick_by_language"]
    scenes, words = set(), set()
    for named in range(3):
        scene = scene_module.build_scene(robot, FACTS)
        task = task_module.load_task("pick_by_language")(entry, FACTS["success"])
        task.lay_out(scene, _Naming(5, named))
        scenes.add(scene.spec.to_xml())
        words.add(task.words["hue"])
    assert (len(scenes), len(words)) == (1, 3)


def test_covered_cubes_leave_no_trace() -> None:
    """Red and blue under the covers: exchanged, every picture and number of an observation is the same."""
    with closing(_started("memory_cover", "clean", 100000)) as env:
        state = env.get_obs()["state"]
        hold = {key: state[key] for key in get_embodiment("arx_x5").dims("joint")}
        before = [_exchanged(env, name) for name in ("cube_1", "cube_2", "cube_3")]
        for _ in range(40):
            env.take_action(hold)
        after = [_exchanged(env, name) for name in ("cube_1", "cube_2", "cube_3")]
    assert len(set(before)) == 3
    assert len(set(after)) == 1


def _exchanged(env: Any, red: str) -> bytes:
    """Return all that is observed, as bytes, while the cube of this name is the red one."""
    episode = env.episodes[0]
    for name in ("cube_1", "cube_2", "cube_3"):
        episode.physics.model.geom(name).rgba[:3] = (0.82, 0.13, 0.1) if name == red else (0.12, 0.25, 0.75)
    obs = env.get_obs()
    frames = [episode.render(camera, 96, 96) for camera in ("cam_head", "cam_left_wrist", "cam_right_wrist")]
    parts = [*obs["state"].values(), *(part for frame in frames for part in (frame.color, frame.depth))]
    return b"".join(np.asarray(part).tobytes() for part in parts) + obs["instruction"].encode()


@pytest.mark.slow
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
    expert = rollout.expert(what)
    with closing(rollout.make(what)) as env:

        def misled(obs: Any) -> Any:
            wrong = next(f"cover_{index}" for index in (1, 2, 3) if f"cover_{index}" != obs["privileged"]["target"])
            return expert({**obs, "privileged": {**obs["privileged"], "target": wrong}})

        assert not rollout.run_episode(env, misled, 100000)["success"]


# -- seeds -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_seeds_are_frozen_for_every_setting(task: str) -> None:
    """Without repetition, apart for each setting; a first episode of a user (seed 0) is never one of them."""
    chosen = [check.seeds(FOLDER, task, setting) for setting in SETTINGS]
    for numbers in chosen:
        assert len(numbers) == len(set(numbers)) >= 100
        assert min(numbers) >= 100000
    assert not set(chosen[0]) & set(chosen[1])
