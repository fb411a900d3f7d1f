"""RoboTwin: its loop with a mock task, its conventions, and errors if its code or assets are missing."""

from __future__ import annotations
import __future__

import ast
import itertools
import json
import os
import subprocess
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import yaml

from tests.support.checkout import ROOT
from tests.support.commands import xpl
from xpl import Client, get_embodiment, rotation
from xpl.action import ActionError, pack
from xpl.client import RequestTimeoutError
from xpl.environment import Environment, NotInstalledError
from xpl.kinematics import Chain
from xpl.poses import compose, pose
from xpl_cli.basics.content import load_module
from xpl_cli.evaluation.records import mock_settings
from xpl_cli.packages import environments
from xpl_cli.serving.launch import running_server

ENV = ROOT / "envs" / "robotwin"
POLICY = ROOT / "policy" / "demo_policy"
ROBOT = get_embodiment("aloha_agilex")
MANIFEST = environments.manifest(ENV)
FACTS = MANIFEST.data
CAMERAS = FACTS["cameras"]
CONVERT, LOOP, UPSTREAM = (load_module(ENV / f"{name}.py") for name in ("convert", "loop", "upstream"))
STAND_IN, EPISODE = (load_module(ENV / f"{name}.py") for name in ("stand_in", "episode"))
STAND_IN_ROBOT = load_module(ENV / "stand_in_robot.py")
SMALL = (12, 16)
STEP = {
    "left_arm_joint_state": np.arange(6) / 10,
    "left_ee_joint_state": [0.25],
    "right_arm_joint_state": np.arange(6) / -10,
    "right_ee_joint_state": [0.75],
}
CHECKOUT = os.environ.get("XPL_ROBOTWIN_CHECKOUT")


def source(**settings: Any) -> Any:
    """Return the source of mock tasks."""
    return STAND_IN.MockSource(**{"step_lim": 6, "size": SMALL, **settings})


def task() -> Any:
    """Return a mock task at the beginning of an episode."""
    made = source().make("stack_blocks_two")
    made.setup_demo(seed=100000, is_test=True)
    return made


def shown(theirs: Any, robot: Any) -> dict[str, Any]:
    """Return the standard observation."""
    whole: dict[str, Any] = CONVERT.observation(
        theirs, cameras=CAMERAS, robot=robot, instruction="stack them", frequency=30
    )
    return whole


class Chunks:
    """A policy that repeats an action step; notes what it is called with."""

    _robotwin_protocol = "ws"

    def __init__(self, step: Any = STEP, length: int = 4, raises: Exception | None = None) -> None:
        self._step, self._length, self._raises = step, length, raises
        self.asked: list[tuple[str, Any]] = []

    def call(self, func_name: str, obs: Any = None) -> Any:
        """Run an operation of the policy."""
        self.asked.append((func_name, obs))
        if func_name != "get_action":
            return None
        if self._raises is not None:
            raise self._raises
        return [dict(self._step) if isinstance(self._step, Mapping) else self._step] * self._length

    @property
    def names(self) -> list[str]:
        """The operations, in order."""
        return [name for name, _ in self.asked]


def played(client: Any, **settings: Any) -> Any:
    """Run RoboTwin's loop with a mock."""
    made = {key: settings.pop(key) for key in ("step_lim", "succeeds_at") if key in settings}
    options = LOOP.EvalOptions("stack_blocks_two", **{"test_num": 1, **settings})
    return LOOP.evaluate(source(**made), client, options, ROBOT, CAMERAS)


# -- conventions -------------------------------------------------------------------------------------------------------


def test_an_observation_becomes_the_standards() -> None:
    """Names of cameras, both instructions, matrices of the standard's shape, grippers, poses, tools."""
    one = task()
    theirs = one.get_obs()
    ours = shown(theirs, one.robot)
    assert (ours["instruction"], ours["instructions"]) == ("stack them", ["stack them"])
    assert (ours["env_idx"], ours["additional_info"]) == (0, {"frequency": 30})
    for name, facts in CAMERAS.items():
        camera, source_camera = ours["vision"][name], theirs["observation"][facts["source"]]
        assert np.array_equal(camera["color"], source_camera["rgb"])
        assert camera["shape"].tolist() == list(SMALL)
        assert np.array_equal(camera["intrinsic_matrix"], source_camera["intrinsic_cv"])
        assert np.array_equal(camera["extrinsics_matrix"][:3], source_camera["extrinsic_cv"])
        assert camera["extrinsics_matrix"][3].tolist() == [0, 0, 0, 1]
    state = ours["state"]
    assert state["left_ee_joint_state"].tolist() == [1.0]  # an episode begins with open grippers
    assert state["left_arm_joint_state"].tolist() == pytest.approx(theirs["joint_action"]["left_arm"])
    assert state["right_ee_pose"].tolist() == pytest.approx(theirs["endpose"]["right_endpose"])
    assert np.linalg.norm(state["right_ee_pose"][3:]) == pytest.approx(1)
    assert state["left_tcp_pose"][2] == pytest.approx(0.8)


def test_the_state_packs_in_the_order_of_robotwins_vector() -> None:
    """Left arm, left gripper, right arm, right gripper: RoboTwin's own `vector` is the same numbers."""
    one = task()
    theirs = one.get_obs()
    flat = pack(CONVERT.state(theirs), ROBOT, "joint")
    assert flat.tolist() == pytest.approx(theirs["joint_action"]["vector"].tolist())


@pytest.mark.parametrize(("action_type", "word", "size"), [("joint", "qpos", 14), ("ee", "ee", 16)])
def test_an_action_becomes_robotwins_flat_vector(action_type: str, word: str, size: int) -> None:
    """And moves what it names: a map and its vector do the same."""
    values = np.linspace(0.1, 0.9, size).astype(np.float32)
    names = ROBOT.dims(action_type)
    parts = np.split(values, np.cumsum(list(names.values()))[:-1])
    for action in (dict(zip(names, parts, strict=True)), values):
        vector, kind = CONVERT.command(action, ROBOT, action_type)
        assert kind == word
        assert vector.tolist() == values.tolist()
        one = task()
        one.take_action(vector, action_type=kind)
        state = CONVERT.state(one.get_obs())
        assert {key: state[key].tolist() for key in names} == {
            key: pytest.approx(part.tolist()) for key, part in zip(names, parts, strict=True)
        }


@pytest.mark.parametrize("action", [{"left_arm_joint_state": [0.0] * 6}, np.zeros(13), np.zeros((1, 14)), "x", None])
def test_what_is_no_action_is_refused(action: Any) -> None:
    """Also an action without an arm, which RoboTwin would hold without a word."""
    with pytest.raises(ActionError):
        CONVERT.command(action, ROBOT, "joint")


# -- the loop ----------------------------------------------------------------------------------------------------------


def test_an_episode_goes_as_in_robotwin() -> None:
    """Case, reset with what it is of, an observation for each step, the end with its outcome."""
    client = Chunks()
    result = played(client)
    middle = ["update_obs", "get_action", *["update_obs"] * 3, "update_obs", "get_action", "update_obs"]
    assert client.names == ["prepare_case", "reset", *middle, "trial_end"]
    case = {
        "task_name": "stack_blocks_two",
        "seed": 100000,
        "instruction": "do stack_blocks_two with the red block",
        "action_type": "joint",
    }
    assert client.asked[0][1] == client.asked[1][1] == case
    assert client.asked[-1][1] == {"task_name": "stack_blocks_two", "seed": 100000, "success": False}
    assert result.episodes[0]["steps"] == 6
    assert result.rate == 0


@pytest.mark.parametrize("seed", [0, 2])
def test_seeds_begin_where_robotwins_do_and_unfit_ones_are_skipped(seed: int) -> None:
    """Unstable ones, and those that the expert does not solve; they count for nothing."""
    result = played(Chunks(), seed=seed, test_num=5)
    first = 100000 * (1 + seed)
    assert [one["seed"] - first for one in result.episodes] == [0, 1, 2, 5, 6]
    assert {key - first: value for key, value in result.skipped.items()} == {3: "unstable", 4: "expert_failed"}


def test_the_expert_is_judged_before_its_task_is_closed() -> None:
    """The runtime's tasks have no robot any more once they are closed."""
    unsolved = source()
    task = type(unsolved.make("x"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(task, "close_env", lambda one, clear_cache=False: setattr(one, "closed", True))
        patch.setattr(task, "check_success", lambda one: not getattr(one, "closed", False))
        result = LOOP.evaluate(unsolved, Chunks(), LOOP.EvalOptions("stack_blocks_two", test_num=1), ROBOT, CAMERAS)
    assert result.skipped == {}


def test_an_expert_that_cannot_solve_only_tells_what_things_are_called() -> None:
    """That of the mock robot: its motions are switched off, and the seed counts."""
    made = source()
    made.has_expert = False
    one = made.make("stack_blocks_two")
    one.setup_demo(seed=100004, is_test=True)  # which the expert does not solve
    calls = []
    one.play_once = lambda: calls.append(one.plan_success) or {"info": {"{A}": "it"}}
    assert LOOP.ask_expert(made, one) == ({"{A}": "it"}, True)
    assert (calls, one.plan_success) == ([False], True)


def test_a_success_ends_the_episode_inside_its_chunk() -> None:
    client = Chunks()
    result = played(client, succeeds_at=2)
    assert (result.episodes[0]["success"], result.episodes[0]["steps"], result.rate) == (True, 2, 1.0)
    assert client.names[2:] == ["update_obs", "get_action", "update_obs", "trial_end"]
    assert client.asked[-1][1]["success"] is True


def test_wordings_that_were_not_seen_are_another_list() -> None:
    assert played(Chunks(), instruction_type="unseen").episodes[0]["instruction"].startswith("please")


def test_what_the_policy_raises_fails_its_episode_and_is_told() -> None:
    """RoboTwin counts it as a failure, too; a lost connection is not the policy's failure."""
    result = played(Chunks(length=0), test_num=2)
    assert [one["success"] for one in result.episodes] == [False, False]
    assert all("empty chunk" in one["error"] for one in result.episodes)
    lost = RequestTimeoutError("no answer within 120 s")
    assert lost.is_infrastructure_error
    with pytest.raises(RequestTimeoutError):
        played(Chunks(raises=lost))


def test_the_search_for_seeds_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the expert solves none, the error has the number of seeds and the reasons."""
    unsolved = source()
    monkeypatch.setattr(type(unsolved.make("x")), "check_success", lambda _self: False)
    with pytest.raises(RuntimeError, match="expert_failed"):
        LOOP.evaluate(unsolved, Chunks(), LOOP.EvalOptions("x", test_num=1), ROBOT, CAMERAS)


def test_the_loop_plays_a_real_server() -> None:
    """Every operation of RoboTwin's client, over the wire; the policy holds still."""
    with (
        running_server(POLICY, {"env_cfg_type": "aloha_agilex", "action_type": "joint"}) as server,
        Client(server.url, trial_id="t", action_case_id="c") as client,
    ):
        result = played(client, test_num=2)
    assert [(one["steps"], one["error"]) for one in result.episodes] == [(6, None), (6, None)]


# -- the robot that stands in ------------------------------------------------------------------------------------------


def test_the_robot_that_stands_in_has_the_standards_kinematics() -> None:
    """Joint by joint, on both sides; the frame of the last joint is the flange."""
    robot = ET.fromstring(STAND_IN_ROBOT.urdf())  # noqa: S314 - our own
    joints = {joint.attrib["name"]: joint for joint in robot.iter("joint")}
    angles = np.array([0.3, 0.8, 0.5, -0.4, 0.2, 0.9])
    for side, name in STAND_IN_ROBOT.SIDES.items():
        frame = STAND_IN_ROBOT.base(side)
        for number, angle in enumerate(angles, 1):
            joint = joints[f"{name}_joint{number}"]
            position, turn, axis = (
                np.array(joint.find(part).attrib[key].split(), float)  # type: ignore[union-attr]
                for part, key in (("origin", "xyz"), ("origin", "rpy"), ("axis", "xyz"))
            )
            frame = compose(frame, pose(position, rotation.from_rpy(turn)))
            frame = compose(frame, pose([0, 0, 0], rotation.from_axis_angle(angle * axis)))
        expected = compose(STAND_IN_ROBOT.base(side), Chain.from_embodiment(ROBOT.data).flange(angles))
        assert np.abs(frame[:3] - expected[:3]).max() < 1e-9
        assert rotation.angle_between(frame[3:], expected[3:]) < 1e-6


def test_the_robot_that_stands_in_is_what_robotwin_reads(tmp_path: Path) -> None:
    """Each folder and file that its runtime reads; every name of the configuration is in the description."""
    STAND_IN_ROBOT.write(tmp_path)
    own = tmp_path / "assets" / "embodiments" / "aloha-agilex"
    assert all((tmp_path / folder).is_dir() for folder in UPSTREAM.NEEDED)
    assert all((own / f"curobo_{side}_tmp.yml").read_text() == "robot_cfg: {}\n" for side in ("left", "right"))
    config = yaml.safe_load((own / "config.yml").read_text())
    robot = ET.fromstring((own / config["urdf_path"]).read_text())  # noqa: S314 - our own
    links, joints = ({one.attrib["name"] for one in robot.iter(kind)} for kind in ("link", "joint"))
    grippers = [(one["base"], one["mimic"][0][0]) for one in config["gripper_name"]]
    assert {*itertools.chain(*config["arm_joints_name"], *grippers), *config["ee_joints"]} <= joints
    assert {*config["move_group"], "left_camera", "right_camera"} <= links
    tree = {one.find("child").attrib["link"] for one in robot.iter("joint")}  # type: ignore[union-attr]
    assert links - tree == {"footprint"}


def test_tasks_with_objects_are_refused_where_a_robot_stands_in() -> None:
    config = {"task": "stack_bowls_two", "embodiment": "aloha_agilex", "setting": "stand_in_robot"}
    env = Environment(lambda setup: EPISODE.RoboTwinEpisode(setup, source()), MANIFEST, config)
    with pytest.raises(ValueError, match=r"only RoboTwin's assets have; stand_in_robot plays blocks_ranking_rgb"):
        env.reset([100000])


def test_every_setting_that_stands_in_says_so_by_its_name() -> None:
    """By which reports know it."""
    assert set(FACTS["stand_ins"]) == {setting for setting in FACTS["settings"] if mock_settings.is_mock(setting)}


def test_without_the_runtime_one_sentence_says_how_to_install_it() -> None:
    if UPSTREAM.importlib.util.find_spec("robotwin") is not None:
        pytest.skip("RoboTwin's runtime is installed here")
    client = load_module(ENV / "client.py")
    config = {"task": "stack_blocks_two", "embodiment": "aloha_agilex", "setting": "stand_in_robot"}
    with pytest.raises(NotInstalledError, match="xpl install robotwin"):
        client.make(config)


# -- against RoboTwin's own file ---------------------------------------------------------------------------------------


def _original(wordings: Any) -> Any:
    """Return the functions of RoboTwin's evaluation script, without its imports."""
    file = Path(CHECKOUT or ".") / "scripts" / "eval_policy_xpolicylab.py"
    if not CHECKOUT or not file.is_file():
        pytest.skip("no checkout of RoboTwin: name one in XPL_ROBOTWIN_CHECKOUT")
    tree = ast.parse(file.read_text(encoding="utf-8"))
    tree.body = [node for node in tree.body if isinstance(node, ast.FunctionDef) or _is_map(node)]
    space: dict[str, Any] = {
        "Any": Any,
        "Mapping": Mapping,
        "Sequence": Sequence,
        "generate_episode_descriptions": wordings,
        "np": np,
        "os": os,
        "subprocess": subprocess,
        "traceback": traceback,
        "UnStableError": STAND_IN.UnstableError,
    }
    flags = __future__.annotations.compiler_flag
    exec(compile(tree, str(file), "exec", flags=flags), space)  # noqa: S102 - a benchmark that whoever runs this named
    return SimpleNamespace(**space)


def _is_map(node: ast.stmt) -> bool:
    return isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "CAMERA_NAME_MAP"


@pytest.mark.parametrize("settings", [{}, {"succeeds_at": 3}, {"step_lim": 9}])
def test_robotwins_own_loop_asks_the_same(settings: dict[str, Any]) -> None:
    """Call by call, value by value, but for the fourth row of matrices."""
    made = source(**settings)
    original = _original(lambda name, infos, count: [made.describe(name, infos[0], count, 0)])
    args = {**made.arguments("stack_blocks_two", "demo_clean"), "policy_name": "p", "ckpt_setting": "c"}
    theirs, ours = Chunks(), Chunks()
    _, won = original.eval_remote_policy(
        "stack_blocks_two",
        made.make("stack_blocks_two"),
        args,
        theirs,
        100000,
        usr_args={"action_type": "joint"},
        test_num=5,
        instruction_type="seen",
    )
    result = played(ours, test_num=5, **settings)
    assert won == sum(one["success"] for one in result.episodes)
    assert theirs.names == ours.names
    for (name, their_obs), (_, our_obs) in zip(theirs.asked, ours.asked, strict=True):
        if name == "update_obs":
            for camera in our_obs["vision"].values():
                camera["extrinsics_matrix"] = camera["extrinsics_matrix"][:3]
        np.testing.assert_equal(_plain(our_obs), _plain(their_obs))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else list(value) if isinstance(value, tuple) else value


def test_the_stand_in_has_the_interface_of_base_task() -> None:
    """Every operation of it is one of RoboTwin's, with the same names of arguments in the same order."""
    file = Path(CHECKOUT or ".") / "envs" / "_base_task.py"
    if not CHECKOUT or not file.is_file():
        pytest.skip("no checkout of RoboTwin: name one in XPL_ROBOTWIN_CHECKOUT")
    tree = ast.parse(file.read_text(encoding="utf-8"))
    base = next(node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Base_Task")
    theirs = {node.name: [one.arg for one in node.args.args] for node in base.body if isinstance(node, ast.FunctionDef)}
    kind = type(task())
    for name in (name for name in vars(kind) if not name.startswith("_")):
        if name == "setup_demo":  # of each task: it takes whatever there is
            continue
        code = vars(kind)[name].__code__
        assert list(code.co_varnames[: code.co_argcount]) == theirs[name], name


# -- the environment ---------------------------------------------------------------------------------------------------


def test_it_plays_as_an_environment_of_the_standard() -> None:
    """With the mock instead of RoboTwin: observations, both action types, success, the step limit."""
    for action_type in ("joint", "ee"):
        config = {"task": "stack_blocks_two", "embodiment": "aloha_agilex", "action_type": action_type}
        env = Environment(
            lambda setup: EPISODE.RoboTwinEpisode(setup, source(step_lim=800, succeeds_at=3)), MANIFEST, config
        )
        env.reset([100000])
        obs = env.get_obs()
        assert obs["instruction"] == "do stack_blocks_two with the red block"
        assert set(obs["vision"]) == set(CAMERAS)
        for _ in range(3):
            env.take_action({key: obs["state"][key] for key in ROBOT.dims(action_type)})
        (result,) = env.results()
        assert (result["success"], result["steps"], result["end_reason"]) == (True, 3, "success")
        assert env.simulated().command.shape == ({"joint": 14, "ee": 16}[action_type],)
        env.close()


@pytest.mark.parametrize(("seed", "said"), [(100003, "unstable"), (100004, "expert does not solve")])
def test_a_seed_that_robotwin_skips_is_no_failure_of_the_policy(seed: int, said: str) -> None:
    config = {"task": "stack_blocks_two", "embodiment": "aloha_agilex", "action_type": "joint"}
    env = Environment(lambda setup: EPISODE.RoboTwinEpisode(setup, source()), MANIFEST, config)
    with pytest.raises(RuntimeError, match=said):
        env.reset([seed])


def test_without_code_or_assets_one_sentence_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No code, a folder that is no checkout, a checkout without assets, and assets of the mock robot."""
    monkeypatch.delenv(UPSTREAM.CHECKOUT, raising=False)
    monkeypatch.setattr(UPSTREAM.importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(NotInstalledError, match="code is not here"):
        UPSTREAM.check()
    monkeypatch.setenv(UPSTREAM.CHECKOUT, str(tmp_path))
    with pytest.raises(NotInstalledError, match="no checkout"):
        UPSTREAM.check()
    (tmp_path / "envs").mkdir()
    (tmp_path / "envs" / "_base_task.py").touch()
    (tmp_path / "env_cfg" / "task_config").mkdir(parents=True)
    with pytest.raises(NotInstalledError, match="assets are not here"):
        UPSTREAM.check()
    for folder in UPSTREAM.NEEDED:
        (tmp_path / folder).mkdir(parents=True)
    assert UPSTREAM.check() == (tmp_path, tmp_path)
    STAND_IN_ROBOT.write(tmp_path)
    with pytest.raises(NotInstalledError, match="the mock robot"):
        UPSTREAM.check()


def test_the_command_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(UPSTREAM.CHECKOUT, raising=False)
    if UPSTREAM.importlib.util.find_spec("robotwin") is not None:
        pytest.skip("RoboTwin's runtime is installed here")
    words = ["--set", "env_cfg_type=aloha_agilex", "--task", "stack_blocks_two", "--workers", "0", "--eval-env", "none"]
    ended = xpl("eval", POLICY, "--env", "robotwin", *words)
    assert ended.code == 4, ended.stderr
    assert "RoboTwin's code is not here" in ended.stderr


_FILES = {
    "envs/__init__.py": "",
    "envs/_base_task.py": "",
    "envs/utils/__init__.py": "",
    "envs/utils/create_actor.py": "class UnStableError(Exception): pass",
    "envs/stack_blocks_two.py": """
import pathlib, sys
from xpl.process.modules import load_module
made = load_module(pathlib.Path({stand_in!r}))
class stack_blocks_two(made.MockTask):
    def __init__(self):
        super().__init__("stack_blocks_two", 800, 2, (12, 16))
    def setup_demo(self, **kwargs):
        assert kwargs["left_robot_file"] == kwargs["right_robot_file"] and kwargs["dual_arm_embodied"] is True
        assert kwargs["left_embodiment_config"] == {{"planner": "x"}} and kwargs["eval_mode"] is True
        assert (kwargs["head_camera_h"], kwargs["head_camera_w"]) == (240, 320)
        assert kwargs["data_type"] == {{"rgb": True, "qpos": True, "endpose": True, "depth": False}}
        assert pathlib.Path("assets/objects").is_dir()
        super().setup_demo(seed=kwargs["seed"])
""",
    "description/utils/generate_episode_instructions.py": """
def generate_episode_descriptions(task, infos, count):
    return [{{"seen": [f"own words with {{infos[0]['{{A}}']}}"], "unseen": []}}]
""",
    "env_cfg/task_config/demo_clean.yml": """
embodiment: [aloha-agilex]
camera: {{head_camera_type: D435}}
data_type: {{rgb: false, depth: false}}
""",
    "env_cfg/task_config/_embodiment_config.yml": "aloha-agilex: {{file_path: ./assets/embodiments/aloha-agilex/}}",
    "env_cfg/task_config/_camera_config.yml": "D435: {{fovy: 37, w: 320, h: 240}}",
    "assets/embodiments/aloha-agilex/config.yml": "planner: x",
    "assets/objects/none": "",
    "assets/background_texture/none": "",
}


def test_a_checkout_is_played_through_its_own_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its settings, its robot's files, its wordings and its folder: with a checkout whose physics is a mock."""
    for name, text in _FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text.format(stand_in=str(ENV / "stand_in.py")))
    monkeypatch.setenv(UPSTREAM.CHECKOUT, str(tmp_path))
    words = ["--set", "env_cfg_type=aloha_agilex", "--task", "stack_blocks_two", "--seed", "100000", "--json"]
    ended = xpl("eval", POLICY, "--env", "robotwin", "--eval-env", "none", *words)
    assert ended.code == 0, ended.stderr
    (episode,) = json.loads(ended.stdout)["episodes"]
    assert episode["instruction"] == "own words with the red block"
    assert (episode["success"], episode["steps"], episode["seed"]) == (True, 2, 100000)


def test_robotwins_own_task_plays() -> None:
    """One episode of ten steps in its own simulator, where its code and its assets are."""
    try:
        UPSTREAM.check()
    except NotInstalledError as error:
        pytest.skip(f"not run: {error}")
    config = {"task": "stack_blocks_two", "embodiment": "aloha_agilex", "action_type": "joint", "max_steps": 10}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(Path.cwd())  # RoboTwin works in its own folder
        env = Environment(EPISODE.RoboTwinEpisode, MANIFEST, config)
        env.reset([100000])
        before = env.get_obs()
        for _ in range(10):
            env.take_action({key: before["state"][key] for key in ROBOT.dims("joint")})
        assert env.is_episode_end()
        env.close()
