"""The mock of RoboDojo's TASK_ENV: as strict as the original, with its observations and ends of episodes."""

from __future__ import annotations

import ast
import os
import textwrap
from copy import deepcopy
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.checkout import ROOT
from xpl import Client, get_embodiment
from xpl.action import ActionError
from xpl_cli.basics.content import load_module
from xpl_cli.packages import environments
from xpl_cli.serving.launch import running_server

ENV = ROOT / "envs" / "robodojo"
POLICY = ROOT / "policy" / "demo_policy"
ROBOT = get_embodiment("arx_x5")
ACTIONS = load_module(ENV / "actions.py")
LOOP = load_module(ENV / "loop.py")
CONFIG = {"task": "stack_bowls", "embodiment": "arx_x5", "action_type": "joint", "cameras": [24, 32], "max_steps": 16}
JOINT = {
    "left_arm_joint_state": [0.1] * 6,
    "left_ee_joint_state": [0.5],
    "right_arm_joint_state": [0.2] * 6,
    "right_ee_joint_state": [0.7],
}
EE = {
    "left_ee_pose": [0.3, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0],
    "left_ee_joint_state": [0.5],
    "right_ee_pose": [0.3, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0],
    "right_ee_joint_state": [0.7],
}


def made(**settings: Any) -> Any:
    """Return the mock."""
    return environments.make("robodojo", {**CONFIG, **settings})


# -- observations ------------------------------------------------------------------------------------------------------


def test_observations_have_the_form_of_robodojo() -> None:
    """Every key that its observation manager writes, with its shape and type."""
    env = made(num_envs=2)
    env.reset([4, 6])
    first, second = env.get_obs_batch()
    assert (first["env_idx"], second["env_idx"]) == (0, 1)
    assert first["data_format_version"] == "v1.0"
    assert first["additional_info"] == {"frequency": 25}
    assert first["instruction"] == "Stack the three bowls together."
    assert list(first["vision"]) == ["cam_head", "cam_left_wrist", "cam_right_wrist"]
    for camera in first["vision"].values():
        assert camera["color"].dtype == np.uint8
        assert camera["color"].shape == camera["shape"] == (24, 32, 3)
        assert set(camera) == {"color", "shape"}
    for side in ("left", "right"):
        assert first["state"][f"{side}_arm_joint_state"].shape == (6,)
        assert first["state"][f"{side}_ee_joint_state"] == [1.0]  # open
        assert np.linalg.norm(first["state"][f"{side}_ee_pose"][3:]) == pytest.approx(1)
    assert set(first["action"]) == set(JOINT)
    assert not np.array_equal(first["vision"]["cam_head"]["color"], second["vision"]["cam_head"]["color"])


def test_matrices_come_in_robodojos_spelling_where_they_are_asked_for() -> None:
    """RoboDojo's `extrinsic_matrix` is camera to world."""
    env = made(setting="matrices")
    env.reset([0])
    camera = env.get_obs()["vision"]["cam_head"]
    assert camera["intrinsic_matrix"].shape == (3, 3)
    assert camera["extrinsic_matrix"].shape == (4, 4)
    assert camera["extrinsic_matrix"][2, 3] == pytest.approx(1.308)  # the head camera is above, seen from the world


def test_an_observation_is_nobody_elses() -> None:
    """A change of one changes no other, and not the environment."""
    env = made()
    env.reset([0])
    one, second = env.get_obs(), env.get_obs()
    one["state"]["left_arm_joint_state"][:] = 9
    one["vision"]["cam_head"]["color"][:] = 0
    again = env.get_obs()
    assert np.array_equal(again["state"]["left_arm_joint_state"], second["state"]["left_arm_joint_state"])
    assert np.array_equal(again["vision"]["cam_head"]["color"], second["vision"]["cam_head"]["color"])


# -- actions -----------------------------------------------------------------------------------------------------------

REFUSED = {
    "no action": {},
    "an unknown key": {**JOINT, "gripper": [1.0]},
    "a key of one arm": {"arm_joint_state": [0.0] * 6, "ee_joint_state": [0.0]},
    "a missing arm": {key: value for key, value in JOINT.items() if not key.startswith("right_arm")},
    "a missing gripper": {key: value for key, value in JOINT.items() if key != "left_ee_joint_state"},
    "both kinds": {**JOINT, **EE},
    "neither kind": {"left_tcp_pose": [0.0] * 7, "right_tcp_pose": [0.0] * 7},
    "seven joints": {**JOINT, "left_arm_joint_state": [0.0] * 7},
    "a batch of one": {**JOINT, "left_arm_joint_state": [[0.0] * 6]},
    "a number for a vector": {**JOINT, "left_ee_joint_state": 0.5},
    "two grippers": {**JOINT, "left_ee_joint_state": [0.5, 0.5]},
}


@pytest.mark.parametrize("action", REFUSED.values(), ids=REFUSED)
def test_what_robodojo_refuses_is_refused_and_moves_nothing(action: dict[str, Any]) -> None:
    env = made()
    env.reset([0])
    before = env.get_obs()
    with pytest.raises(ActionError):
        env.take_action(action)
    after = env.get_obs()
    assert env.take_action_cnt == [0]
    assert np.array_equal(before["state"]["left_arm_joint_state"], after["state"]["left_arm_joint_state"])


def test_what_robodojo_takes_is_executed() -> None:
    """Joints, poses, arrays, tuples, and further poses that are not read; grippers are clipped to 0 to 1."""
    env = made()
    env.reset([0])
    env.take_action(
        {**JOINT, "left_ee_joint_state": [1.7], "right_ee_joint_state": (-0.3,), "left_tcp_pose": [0.0] * 7}
    )
    state = env.get_obs()["state"]
    assert state["left_arm_joint_state"].tolist() == JOINT["left_arm_joint_state"]
    assert (state["left_ee_joint_state"], state["right_ee_joint_state"]) == ([1.0], [0.0])
    env.take_action({key: np.array(value) for key, value in EE.items()})
    assert env.get_obs()["state"]["right_ee_pose"].tolist() == EE["right_ee_pose"]
    assert env.take_action_cnt == [2]


@cache
def _original() -> Any:
    """Return RoboDojo's own checks, taken from a checkout; None where none is named."""
    checkout = os.environ.get("XPL_ROBODOJO_CHECKOUT")
    file = Path(checkout or ".") / "src" / "eval_client" / "eval_env.py"
    if not checkout or not file.is_file():
        return None
    names = ("validate_action_dict", "get_action_type")
    text = file.read_text(encoding="utf-8")
    nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef) and node.name in names]
    space: dict[str, Any] = {"np": np, "deepcopy": deepcopy}
    for node in nodes:
        source = textwrap.dedent(ast.get_source_segment(text, node, padded=True) or "")
        exec(source, space)  # noqa: S102 - a benchmark that whoever runs this has named
    arms = [SimpleNamespace(type="target", arm_name=f"{side}_arm") for side in ("left", "right")]
    robots = SimpleNamespace(robot_list=arms, process_name=lambda name: f"{name}_joint_state")
    dims = {"arm_dim": [6, 6], "ee_dim": [1, 1]}
    return SimpleNamespace(robot_manager=robots, robot_action_dim_info=dims), *(space[name] for name in names)


_KEYS = st.sampled_from([*ACTIONS.dimensions(ROBOT), "arm_joint_state", "noise"])
_VALUES = st.one_of(
    st.integers(0, 8).map(lambda size: [0.5] * size),
    st.integers(5, 8).map(np.zeros),
    st.sampled_from([0.5, None, "x", [[0.0] * 6], (0.1,) * 7]),
)


@given(action=st.dictionaries(_KEYS, _VALUES, max_size=6), base=st.sampled_from([{}, JOINT, EE]))
def test_strictness_is_robodojos_own(action: dict[str, Any], base: dict[str, Any]) -> None:
    """The same actions are refused by its file, where a checkout is there."""
    original = _original()
    if original is None:
        pytest.skip("no checkout of RoboDojo: name one in XPL_ROBODOJO_CHECKOUT")
    env, validate, kind = original
    whole = {**base, **action}
    theirs = None
    try:
        validate(env, whole)
        theirs = kind(env, whole)
    except (ValueError, TypeError):
        pass
    ours = None
    try:
        ACTIONS.validate(whole, ROBOT)
        ours = ACTIONS.kind(whole, ROBOT)
    except ActionError:
        pass
    assert ours == theirs


# -- episodes ----------------------------------------------------------------------------------------------------------


def test_the_running_list_shrinks_and_the_end_comes_with_the_last() -> None:
    """Odd layouts end by script, even ones at the step limit; none is a success."""
    env = made(num_envs=3)
    env.reset([1, 2, 3])
    lengths, count = [], 0
    while not env.is_episode_end():
        running = env.get_running_env_idx_list()
        lengths.append(len(running))
        env.take_action_batch([JOINT] * len(running), running)
        count += 1
    assert lengths == sorted(lengths, reverse=True)
    assert set(lengths) == {1, 2, 3}
    assert count == 16
    assert env.get_running_env_idx_list() == []
    results = env.results()
    assert [result["end_reason"] for result in results] == ["scripted_end", "max_steps", "scripted_end"]
    assert all(result["success"] is None and result["score"] is None for result in results)


def test_an_environment_that_has_ended_is_left_out_of_a_step() -> None:
    """RoboDojo breaks where a step mixes ended and running ones, and ignores a step of ended ones alone."""
    env = made(num_envs=2)
    env.reset([1, 0])
    while len(env.get_running_env_idx_list()) == 2:
        env.take_action_batch([JOINT, JOINT], [0, 1])
    counts = list(env.take_action_cnt)
    with pytest.raises(ActionError, match="get_running_env_idx_list"):
        env.take_action_batch([JOINT, JOINT], [0, 1])
    env.take_action_batch([JOINT], [0])
    assert env.take_action_cnt == counts
    assert [obs["env_idx"] for obs in env.get_obs_batch()] == [0, 1]  # all of them, as there


def test_the_last_frame_of_an_episode_belongs_to_its_film() -> None:
    """Observations after the end do not, unless they are requested as the last frame."""
    env = made(max_steps=1)
    env.reset([0])
    env.get_obs()
    env.take_action(JOINT)  # looks at what has ended
    assert env.frames == [2]
    env.get_obs()
    assert env.frames == [2]
    env.get_obs_batch([0], last_frame=True)
    assert env.frames == [3]


def test_fewer_layouts_than_environments_leave_some_idle() -> None:
    env = made(num_envs=3)
    env.reset([5, None])
    assert env.get_running_env_idx_list() == [0]
    assert not env.is_episode_end()


# -- RoboDojo's loop, through a real server ----------------------------------------------------------------------------


class Noted:
    """A client whose operations are noted."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self.asked: list[str] = []

    def call(self, func_name: str, obs: Any = None) -> Any:
        """Run an operation of the policy."""
        self.asked.append(func_name)
        return self._client.call(func_name=func_name, obs=obs)


def test_an_adapters_own_deploy_plays_as_robodojo_calls_it() -> None:
    """Both functions, by keyword, with two resets at the beginning of each batch of layouts."""
    with running_server(POLICY, {"env_cfg_type": "arx_x5", "action_type": "joint"}) as server:
        for count in (1, 3):
            with Client(server.url) as client:
                noted = Noted(client)
                results = LOOP.evaluate(made(num_envs=count), load_module(POLICY / "deploy.py"), noted, range(4))
            assert [result["seed"] for result in results] == [0, 1, 2, 3]
            assert [result["steps"] for result in results] == [16, 6, 16, 10]
            assert noted.asked.count("reset") == 2 * -(-4 // count)
            assert noted.asked[:2] == ["reset", "reset"]
            assert ("update_obs_batch" in noted.asked) == (count > 1)


def test_a_loop_that_leaves_before_the_end_is_told() -> None:
    env = made()
    deploy = SimpleNamespace(eval_one_episode=lambda TASK_ENV, model_client: TASK_ENV.take_action(JOINT))  # noqa: N803
    deploy.eval_one_episode.__name__ = "eval_one_episode"
    client = SimpleNamespace(call=lambda **_: None)
    with pytest.raises(RuntimeError, match="still run"):
        LOOP.evaluate(env, deploy, client, [0])
