"""The MuJoCo environment: schema, determinism, safety, embodiments, tasks."""

import hashlib
import os
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from xpl import _spec as spec
from xpl import get_embodiment
from xpl.action import ActionError
from xpl.observation import ObservationError
from xpl.poses import transform
from xpl_cli.basics.content import content_folder, load_module

pytest.importorskip("mujoco")

from benchmarks.environments_bench import ours

FOLDER = content_folder("envs") / "mujoco"
FACTS = load_module(FOLDER / "manifest.py").manifest().data
TASKS = sorted(FACTS["tasks"])
Expert = load_module(content_folder("policy") / "scripted_expert" / "model.py").Model
make = load_module(FOLDER / "client.py").make


def _env(**config: Any) -> Any:
    return make({"task": "lift_cube", "embodiment": "arx_x5", "cameras": False, **config})


def _hold(obs: dict[str, Any], action_type: str = "joint", embodiment: str = "arx_x5") -> dict[str, Any]:
    """Return the action that commands what is observed."""
    return {key: obs["state"][key] for key in get_embodiment(embodiment).dims(action_type)}


def _random_action(rng: np.random.Generator) -> dict[str, Any]:
    arm = get_embodiment("arx_x5").arms[0]
    sides = {}
    for prefix in ("left_", "right_"):
        sides[f"{prefix}arm_joint_state"] = rng.uniform(arm.lower, arm.upper)
        sides[f"{prefix}ee_joint_state"] = rng.random(1)
    return sides


def _solve(env: Any, seed: int, action_type: str = "joint", embodiment: str = "arx_x5") -> dict[str, Any]:
    """Let the expert play one episode in this process."""
    policy = Expert({"env_cfg_type": embodiment, "action_type": action_type})
    env.reset([seed])
    while not env.is_episode_end():
        policy.update_obs(env.get_obs())
        for action in policy.get_action():
            env.take_action(action)
    return env.results()[0]


# -- observations ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_observation_follows_the_schema(task: str) -> None:
    env = _env(task=task, cameras=[48, 64])
    env.reset([5])
    obs = env.get_obs()
    assert obs["data_format_version"] == spec.DATA_FORMAT_VERSION
    wording = re.sub(r"\\{\w+\\}", r"\\w+", re.escape(FACTS["tasks"][task]["instruction"]))
    assert re.fullmatch(wording, obs["instruction"])  # what is in braces is drawn by the seed
    assert obs["env_idx"] == 0
    assert obs["additional_info"] == {"frequency": FACTS["control_frequency"]}
    assert "privileged" not in obs
    assert list(obs["vision"]) == list(spec.CAMERAS[2])
    for camera in obs["vision"].values():
        assert (camera["color"].shape, camera["color"].dtype) == ((48, 64, 3), np.uint8)
        assert (camera["depth"].shape, camera["depth"].dtype) == ((48, 64), np.float32)
        assert camera["intrinsic_matrix"].shape == (3, 3)
        assert camera["extrinsics_matrix"].shape == (4, 4)
        assert camera["shape"].tolist() == [48, 64, 3]
        assert camera["color"].std() > 5
        assert camera["depth"].min() > 0
    state = obs["state"]
    sizes = {"arm_joint_state": 6, "ee_joint_state": 1, "ee_pose": 7, "tcp_pose": 7, "delta_ee_pose": 7}
    assert {key: value.shape for key, value in state.items()} == {
        prefix + key: (size,) for prefix in spec.ARM_PREFIXES[2] for key, size in sizes.items()
    }
    for key, value in state.items():
        assert value.dtype == np.float32
        if key.endswith("pose"):
            assert np.isclose(np.sum(value[3:] ** 2), 1.0, atol=1e-5)


def test_the_default_resolution_is_the_manifests() -> None:
    env = make({"task": "lift_cube", "embodiment": "arx_x5"})
    env.reset([0])
    entry = FACTS["cameras"]["cam_head"]
    assert env.get_obs()["vision"]["cam_head"]["color"].shape == (entry["height"], entry["width"], 3)
    env.reset([0], {"cameras": False})
    assert env.get_obs()["vision"] == {}


def test_truth_is_shown_only_when_asked_for() -> None:
    env = _env(task="handover_block", privileged=True)
    env.reset([0])
    truth = env.get_obs()["privileged"]
    assert truth["task"] == "handover_block"
    assert truth["left_base_pose"].shape == (7,)
    assert truth["objects"]["block"]["pose"].shape == (7,)
    assert truth["goals"]["pad"]["position"].shape == (3,)
    env.reset([0], {"privileged": False})
    assert "privileged" not in env.get_obs()


def test_delta_pose_is_the_last_steps_motion() -> None:
    """It is the identity after reset, and small and unit after a step."""
    env = _env()
    env.reset([0])
    obs = env.get_obs()
    assert np.allclose(obs["state"]["left_delta_ee_pose"], [0, 0, 0, 1, 0, 0, 0], atol=1e-6)
    action = _hold(obs)
    action["left_arm_joint_state"] = action["left_arm_joint_state"] + 0.1
    before = obs["state"]["left_ee_pose"]
    env.take_action(action)
    state = env.get_obs()["state"]
    moved = transform(before.astype(np.float64), state["left_delta_ee_pose"][:3])
    assert np.allclose(moved, state["left_ee_pose"][:3], atol=1e-5)
    assert np.any(np.abs(state["left_delta_ee_pose"][:3]) > 1e-3)


# -- determinism -------------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_trajectory_and_pixels() -> None:
    digests, images = [], []
    for seed, action_seed in ((7, 0), (7, 0), (8, 0), (7, 1)):
        env = _env(cameras=[32, 32])
        env.reset([seed])
        rng = np.random.default_rng(action_seed)
        for _ in range(10):
            env.take_action(_random_action(rng))
        digests.append(env.results()[0]["digest"])
        images.append(env.get_obs()["vision"]["cam_head"]["color"].tobytes())
    assert digests[0] == digests[1]
    assert images[0] == images[1]
    assert len(set(digests)) == 3


def _played() -> str:
    """Return digests of a randomized episode in pose control: of its states, and of the last pictures."""
    env = _env(task="handover_block", embodiment="piper", action_type="ee", setting="randomized", cameras=[48, 64])
    env.reset([11])
    rng = np.random.default_rng(0)
    hold = _hold(env.get_obs(), "ee", "piper")
    for _ in range(15):
        env.take_action({key: value + rng.normal(0, 0.01, value.shape) for key, value in hold.items()})
    digest = hashlib.sha256()
    for view in env.get_obs()["vision"].values():
        digest.update(view["color"].tobytes() + view["depth"].tobytes())
    return f"{env.results()[0]['digest']} {digest.hexdigest()}"


def test_two_processes_give_the_same_trajectory_and_pixels() -> None:
    """Whatever seeds Python's hashes."""
    again = subprocess.run(
        [sys.executable, "-c", "from tests.environments.test_mujoco import _played; print(_played())"],
        cwd=FOLDER.parent.parent,
        env={**os.environ, "PYTHONHASHSEED": "1" if os.environ.get("PYTHONHASHSEED") != "1" else "2"},
        check=True,
        capture_output=True,
        text=True,
    )
    assert again.stdout.strip() == _played()


def test_an_episode_does_not_depend_on_the_one_before() -> None:
    env = _env()
    env.reset([3])
    for _ in range(5):
        env.take_action(_random_action(np.random.default_rng(0)))
    env.reset([4])
    env.reset([4])
    fresh = _env()
    fresh.reset([4])
    assert env.results() == fresh.results()


def test_rendering_does_not_disturb_the_physics() -> None:
    digests = []
    for cameras in (False, [16, 16]):
        env = _env(cameras=cameras)
        env.reset([2])
        for _ in range(5):
            env.take_action(_hold(env.get_obs()))
        digests.append(env.results()[0]["digest"])
    assert digests[0] == digests[1]


# -- control and safety ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("embodiment", FACTS["embodiments"])
@pytest.mark.parametrize("action_type", spec.ACTION_TYPES)
def test_commanding_the_current_pose_stays(embodiment: str, action_type: str) -> None:
    env = _env(embodiment=embodiment, action_type=action_type)
    env.reset([0])
    start = env.get_obs()
    for _ in range(25):
        report = env.take_action(_hold(env.get_obs(), action_type, embodiment))
        assert report["corrections"] == {}
    end = env.get_obs()
    for prefix in get_embodiment(embodiment).prefixes:
        key = f"{prefix}ee_pose"
        assert np.abs(end["state"][key] - start["state"][key]).max() < 1e-3
    assert env.results()[0]["score"] == 0.0


def test_clamps_are_counted_and_reported() -> None:
    """A jump past the limits is cut to limit and speed, with both amounts; results count them."""
    env = _env()
    env.reset([0])
    before = env.get_obs()
    arm = get_embodiment("arx_x5").arms[0]
    action = _hold(before)
    action["left_arm_joint_state"] = arm.upper + 0.5
    action["right_arm_joint_state"] = np.array([0, 0, 1e30, 0, 0, 0])  # finite is finite, and no overflow is warned of
    action["right_ee_joint_state"] = [1.25]
    report = env.take_action(action)
    assert report["corrections"]["left_"]["joint_limit"] == pytest.approx(0.5, abs=1e-5)
    assert report["corrections"]["left_"]["joint_speed"] > 1.0
    assert report["corrections"]["right_"]["gripper_range"] == pytest.approx(0.25)
    moved = env.get_obs()["state"]["left_arm_joint_state"] - before["state"]["left_arm_joint_state"]
    assert np.all(np.abs(moved) <= arm.velocity / FACTS["control_frequency"] + 1e-3)
    assert env.results()[0]["corrections"] == {"joint_limit": 2, "joint_speed": 2, "gripper_range": 1}


def test_an_unreachable_pose_is_reported() -> None:
    env = _env(action_type="ee")
    env.reset([0])
    action = _hold(env.get_obs(), "ee")
    action["right_ee_pose"] = action["right_ee_pose"] + np.array([0, 1.5, 0, 0, 0, 0, 0])
    report = env.take_action(action)
    assert report["corrections"]["right_"]["unreachable"] > 0.3
    assert report["corrections"]["right_"]["rotation_error"] >= 0.0
    assert "left_" not in report["corrections"]
    assert env.results()[0]["corrections"]["unreachable"] == 1


def test_a_quaternion_is_normalised_or_refused() -> None:
    """A length away from one is reported and repaired; no length at all is an error and moves nothing."""
    env = _env(action_type="ee")
    env.reset([0])
    action = _hold(env.get_obs(), "ee")
    long = {**action, "left_ee_pose": action["left_ee_pose"] * np.array([1, 1, 1, 2, 2, 2, 2])}
    assert env.take_action(long)["corrections"]["left_"] == {"quaternion_norm": pytest.approx(1.0)}
    digest = env.results()[0]["digest"]
    with pytest.raises(ActionError, match="right_ee_pose must hold a unit quaternion"):
        env.take_action({**action, "right_ee_pose": np.zeros(7)})
    assert env.results()[0]["digest"] == digest


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_non_finite_action_ends_the_episode_before_the_physics(bad: Any) -> None:
    env = _env()
    env.reset([0])
    obs = env.get_obs()
    action = _hold(obs)
    action["left_arm_joint_state"] = np.array([0, 0, bad, 0, 0, 0])
    assert env.take_action(action)["end_reason"] == "non_finite_action"
    assert env.is_episode_end()
    result = env.results()[0]
    assert (result["end_reason"], result["success"], result["steps"]) == ("non_finite_action", False, 0)
    assert np.array_equal(env.get_obs()["state"]["left_arm_joint_state"], obs["state"]["left_arm_joint_state"])


def test_a_state_beyond_all_measure_is_none() -> None:
    """Physics that ran away is noticed, and numpy does not warn of the sum."""
    env = _env()
    env.reset([0])
    physics = env._envs[0].episode.physics
    assert physics.is_finite()
    physics.data.qvel[:] = 1e200
    physics.changed()
    assert not physics.is_finite()


# -- several environments ----------------------------------------------------------------------------------------------


def test_the_running_list_shrinks() -> None:
    env = _env(num_envs=3, max_steps=4)
    env.reset([0, 1, 2])
    assert env.get_running_env_idx_list() == [0, 1, 2]
    observations = env.get_obs_batch()
    assert [obs["env_idx"] for obs in observations] == [0, 1, 2]
    broken = {**_hold(observations[1]), "left_ee_joint_state": [np.nan]}
    env.take_action_batch([_hold(observations[0]), broken, _hold(observations[2])], [0, 1, 2])
    assert env.get_running_env_idx_list() == [0, 2]
    assert [obs["env_idx"] for obs in env.get_obs_batch([2, 0])] == [2, 0]
    while not env.is_episode_end():
        running = env.get_running_env_idx_list()
        env.take_action_batch([_hold(obs) for obs in env.get_obs_batch(running)], running)
    results = env.results()
    assert [result["end_reason"] for result in results] == ["max_steps", "non_finite_action", "max_steps"]
    assert [result["steps"] for result in results] == [4, 0, 4]
    late = env.take_action_batch([_hold(observations[0])], [0])[0]
    assert (late["step"], late["end_reason"]) == (4, "max_steps")


def test_batch_equals_single() -> None:
    batch, single = _env(num_envs=2), _env()
    batch.reset([5, 6])
    single.reset([6])
    rng = np.random.default_rng(0)
    for _ in range(5):
        actions = [_random_action(rng), _random_action(rng)]
        batch.take_action_batch(actions, [0, 1])
        single.take_action(actions[1])
    assert batch.results()[1]["digest"] == single.results()[0]["digest"]


@pytest.mark.parametrize(
    ("config", "message"), [({"renderer": "eg"}, "did you mean 'egl'"), ({"task": "lift_cub"}, "task")]
)
def test_a_wrong_configuration_is_refused(config: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        _env(**config)


# -- experts and robots ------------------------------------------------------------------------------------------------


def test_the_expert_says_what_it_lacks() -> None:
    env = _env()
    env.reset([0])
    policy = Expert({"env_cfg_type": "arx_x5"})
    policy.update_obs(env.get_obs())
    with pytest.raises(ObservationError, match="privileged"):
        policy.get_action()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("embodiment", [name for name in FACTS["embodiments"] if len(get_embodiment(name).arms) == 1])
@pytest.mark.parametrize("action_type", spec.ACTION_TYPES)
def test_one_arm_works_too(embodiment: str, action_type: str) -> None:
    """A single arm has unprefixed keys, its own camera set, and lifts the cube; so does one of seven joints."""
    env = _env(embodiment=embodiment, action_type=action_type, cameras=[32, 32], privileged=True)
    env.reset([0])
    obs = env.get_obs()
    assert list(obs["vision"]) == list(spec.CAMERAS[1])
    assert set(get_embodiment(embodiment).dims(action_type)) <= set(obs["state"])
    env.reset([0], {"cameras": False})
    assert _solve(env, 0, action_type, embodiment)["success"]


@pytest.mark.parametrize("embodiment", FACTS["embodiments"])
def test_the_gripper_opens_to_the_stroke(embodiment: str) -> None:
    """Schema 1 is the embodiment's stroke between the fingers, 0 is none; in between it is proportional."""
    robot = get_embodiment(embodiment)
    env = _env(embodiment=embodiment)
    env.reset([0])
    action = _hold(env.get_obs(), embodiment=embodiment)
    physics = env.episodes[0].physics
    prefix = robot.prefixes[0]
    for opening in (1.0, 0.5, 0.0):
        action[f"{prefix}ee_joint_state"] = np.array([opening], dtype=np.float32)
        for _ in range(25):
            env.take_action(action)
        travel = [physics.data.joint(f"{prefix}finger_{side}").qpos[0] for side in ("left", "right")]
        assert sum(travel) == pytest.approx(opening * robot.arms[0].stroke, abs=2e-3)
        assert env.get_obs()["state"][f"{prefix}ee_joint_state"][0] == pytest.approx(opening, abs=0.03)


@pytest.mark.parametrize("embodiment", FACTS["embodiments"])
def test_torques_are_bounded(embodiment: str) -> None:
    robot = get_embodiment(embodiment)
    env = _env(embodiment=embodiment)
    env.reset([0])
    action, rng = _hold(env.get_obs(), embodiment=embodiment), np.random.default_rng(0)
    physics, arm = env.episodes[0].physics, robot.arms[0]
    bounds = {f"{p}{j['name']}": j["effort"] for p in robot.prefixes for j in robot.data["arm"]["joints"]}
    for _ in range(20):
        for prefix in robot.prefixes:
            action[f"{prefix}arm_joint_state"] = rng.uniform(arm.lower, arm.upper)
        env.take_action(action)
        for name, bound in bounds.items():
            assert abs(physics.data.actuator(name).force[0]) <= bound + 1e-9


def test_an_episode_is_what_mj_step_alone_makes_of_it() -> None:
    """Played again by `mj_step` with the same controls, the expert's episode ends in the same state, bit by bit.

    How much of the environment's time that is, `./dev bench environments` tells.
    """
    assert ours.check("stack_blocks_two", "joint") > 100  # raises where the states differ
