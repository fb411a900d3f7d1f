"""The MuJoCo environment: schema, determinism, geometry, safety, tasks."""

from typing import Any

import numpy as np
import pytest

from xpl import _spec as spec
from xpl import get_embodiment
from xpl.action import ActionError, pack
from xpl.embodiment import _from_entry
from xpl.observation import ObservationError
from xpl.poses import invert, transform
from xpl_cli.content import load_module, room

pytest.importorskip("mujoco")

FOLDER = room("envs") / "mujoco"
FACTS = load_module(FOLDER / "manifest.py").manifest()
TASKS = sorted(FACTS["tasks"])
Expert = load_module(room("policy") / "scripted_expert" / "model.py").Model
make = load_module(FOLDER / "client.py").make
episode_module = load_module(FOLDER / "episode.py")


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
    """Keys, shapes and dtypes are the standard's, and quaternions are unit."""
    env = _env(task=task, cameras=[48, 64])
    env.reset([5])
    obs = env.get_obs()
    assert obs["data_format_version"] == spec.DATA_FORMAT_VERSION
    assert obs["instruction"] == FACTS["tasks"][task]["instruction"]
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
    """Cameras are on unless switched off, at the size env.yml gives."""
    env = make({"task": "lift_cube", "embodiment": "arx_x5"})
    env.reset([0])
    entry = FACTS["cameras"]["cam_head"]
    assert env.get_obs()["vision"]["cam_head"]["color"].shape == (entry["height"], entry["width"], 3)
    env.reset([0], {"cameras": False})
    assert env.get_obs()["vision"] == {}


def test_truth_is_shown_only_when_asked_for() -> None:
    """The privileged map holds what the README lists."""
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


# -- cameras -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("camera", spec.CAMERAS[2])
def test_every_pixel_is_where_projection_puts_it(camera: str) -> None:
    """The cube's pixels, back-projected by depth, intrinsics and extrinsics, lie on the cube's surface.

    And its corners project to within half a pixel of the rectangle that segmentation shows.
    """
    env = _env(task="handover_block", privileged=True, cameras=[224, 224])
    env.reset([3])
    obs = env.get_obs()
    episode = env._episodes[0]
    view, model = obs["vision"][camera], episode._physics.model
    seen = episode._cameras[camera].render(episode._physics.data).segmentation
    block = obs["privileged"]["objects"]["block"]
    rows, columns = np.nonzero(seen == model.geom("block").id)
    if camera == "cam_right_wrist":
        assert len(rows) == 0  # the block is before the other arm
        return
    assert len(rows) > 50
    focal, center = view["intrinsic_matrix"][0, 0], view["intrinsic_matrix"][:2, 2]
    depth = view["depth"][rows, columns].astype(np.float64)
    in_camera = np.stack([(columns - center[0]) / focal, (rows - center[1]) / focal, np.ones(len(rows))]) * depth
    to_world = np.linalg.inv(view["extrinsics_matrix"])
    world = (to_world[:3, :3] @ in_camera + to_world[:3, 3:]).T
    local = transform(invert(block["pose"]), world) / block["half_size"]
    assert np.allclose(np.abs(local).max(axis=1), 1.0, atol=1e-3)

    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = transform(block["pose"], signs * block["half_size"])
    projected = view["extrinsics_matrix"][:3, :3] @ corners.T + view["extrinsics_matrix"][:3, 3:]
    u, v = focal * projected[:2] / projected[2] + center[:, None]
    for pixels, exact in ((columns, u), (rows, v)):
        low, high = np.clip([exact.min(), exact.max()], 0, 223)
        # A pixel shows what its centre sees, so the outermost pixel lies between the outline and one pixel inside it:
        # within half a pixel of the middle of that range.
        assert abs(pixels.min() - (low + 0.5)) <= 0.5 + 1e-6
        assert abs(pixels.max() - (high - 0.5)) <= 0.5 + 1e-6


@pytest.mark.parametrize("camera", spec.CAMERAS[2])
def test_a_known_point_lands_on_its_pixel(camera: str) -> None:
    """A geom's surface point, projected, meets the depth that the image has at the nearest pixel."""
    env = _env(cameras=[224, 224], privileged=True)
    env.reset([3])
    view = env.get_obs()["vision"][camera]
    matrix, intrinsics = view["extrinsics_matrix"], view["intrinsic_matrix"]
    rng, checked = np.random.default_rng(0), 0
    top = FACTS["scene"]["table"]["top"]
    for x, y in rng.uniform([-0.35, -0.3], [0.35, 0.3], size=(200, 2)):
        point = matrix[:3, :3] @ [x, y, top] + matrix[:3, 3]
        u, v = (intrinsics @ point)[:2] / point[2]
        if point[2] > 0 and 0 <= u <= 223 and 0 <= v <= 223:
            # Depth of the table at the pixel's centre, to first order, differs by less than half a pixel's slope.
            slope = np.abs(np.gradient(view["depth"])).max(axis=0)[round(v), round(u)]
            difference = view["depth"][round(v), round(u)] - point[2]
            if difference < -0.01:
                continue  # something stands in front of the table here
            assert abs(difference) <= max(slope, 1e-3)
            checked += 1
    assert checked > 10


@pytest.mark.parametrize("camera", [*spec.CAMERAS[2], *spec.OPTIONAL_CAMERAS])
def test_shortcuts_change_no_pixel(camera: str) -> None:
    """Closed-form backdrop and bounding boxes give exactly the geoms that rays at everything give."""
    import mujoco

    env = _env(task="handover_block")
    env.reset([1])
    rng = np.random.default_rng(0)
    for _ in range(5):
        env.take_action(_random_action(rng))
    episode = env._episodes[0]
    model, data = episode._physics.model, episode._physics.data
    view = load_module(FOLDER / "camera.py").RayCamera(model, camera, 120, 90, episode._backdrop())
    frame = view.render(data)
    count = 120 * 90
    hit, distance = np.empty(count, dtype=np.int32), np.empty(count)
    rays = np.ascontiguousarray((view._axes(data) @ view._rays).T).reshape(-1)
    mujoco.mj_multiRay(model, data, data.cam_xpos[view._id], rays, None, 1, -1, hit, distance, None, count, 20.0)
    assert np.array_equal(frame.segmentation.ravel(), hit)
    assert np.allclose(frame.depth.ravel(), distance * view._along_axis, atol=1e-5)


# -- determinism -------------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_trajectory_and_pixels() -> None:
    """Digest, state and images are equal bit by bit; another seed or action differs."""
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


def test_an_episode_does_not_depend_on_the_one_before() -> None:
    """A used environment, reset, equals a fresh one; resetting twice changes nothing."""
    env = _env()
    env.reset([3])
    for _ in range(5):
        env.take_action(_random_action(np.random.default_rng(0)))
    env.reset([4])
    env.reset([4])
    fresh = _env()
    fresh.reset([4])
    assert env.results() == fresh.results()


def test_seeds_count_on_when_none_are_given() -> None:
    """The first reset uses the configured seed, later ones those that follow."""
    env = _env(num_envs=2, seed=10)
    env.reset()
    assert [result["seed"] for result in env.results()] == [10, 11]
    env.reset()
    assert [result["seed"] for result in env.results()] == [12, 13]


def test_rendering_does_not_disturb_the_physics() -> None:
    """With and without cameras the states are the same."""
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
    """The observed joints, or the observed flange pose, sent back as action move nothing and correct nothing."""
    env = _env(embodiment=embodiment, action_type=action_type)
    env.reset([0])
    start = env.get_obs()
    for _ in range(25):
        report = env.take_action(_hold(env.get_obs(), action_type, embodiment))
        assert report["corrections"] == {}
    end = env.get_obs()
    for prefix in spec.ARM_PREFIXES[2]:
        key = f"{prefix}ee_pose"
        assert np.abs(end["state"][key] - start["state"][key]).max() < 1e-3
    assert env.results()[0]["score"] == 0.0


def test_gripper_closes_at_zero_and_opens_at_one() -> None:
    """The observed opening follows the command; fingertips meet when closed and are a stroke apart when open."""
    env = _env()
    env.reset([0])
    physics = env._episodes[0]._physics
    for command in (0.0, 1.0, 0.5):
        for _ in range(15):
            env.take_action({**_hold(env.get_obs()), "left_ee_joint_state": [command]})
        assert np.isclose(env.get_obs()["state"]["left_ee_joint_state"][0], command, atol=0.02)
        left, right = (physics.body_pose(f"left_finger_{side}")[:3] for side in ("left", "right"))
        thickness = 2 * physics.model.geom_size[physics.model.body("left_finger_left").geomadr[0]][1]
        gap = np.sqrt(np.sum((left - right) ** 2)) - thickness
        assert np.isclose(gap, command * get_embodiment("arx_x5").arms[0].stroke, atol=2e-3)


def test_clamps_are_counted_and_reported() -> None:
    """A jump past the limits is cut to limit and speed, with both amounts; results count them."""
    env = _env()
    env.reset([0])
    before = env.get_obs()
    arm = get_embodiment("arx_x5").arms[0]
    action = _hold(before)
    action["left_arm_joint_state"] = arm.upper + 0.5
    action["right_ee_joint_state"] = [1.25]
    report = env.take_action(action)
    assert report["corrections"]["left_"]["joint_limit"] == pytest.approx(0.5, abs=1e-5)
    assert report["corrections"]["left_"]["joint_speed"] > 1.0
    assert report["corrections"]["right_"]["gripper_range"] == pytest.approx(0.25)
    moved = env.get_obs()["state"]["left_arm_joint_state"] - before["state"]["left_arm_joint_state"]
    assert np.all(np.abs(moved) <= arm.velocity / FACTS["control_frequency"] + 1e-3)
    assert env.results()[0]["corrections"] == {"joint_limit": 1, "joint_speed": 1, "gripper_range": 1}


def test_an_unreachable_pose_is_reported() -> None:
    """The flange goes as near as it can, and the step says how far off it stays."""
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
    """State stays finite and unchanged; the report and the result say why."""
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"left_arm_joint_state": np.zeros(7)}, r"shape \(6,\)"),
        ({"left_ee_pose": np.zeros(7)}, "left_ee_pose"),
        ({"left_arm_joint_state": None}, "6 numbers|shape"),
    ],
)
def test_a_malformed_action_is_an_error(change: dict[str, Any], message: str) -> None:
    """Wrong dimensions and mixed control are refused, and nothing moves."""
    env = _env()
    env.reset([0])
    with pytest.raises(ActionError, match=message):
        env.take_action({**_hold(env.get_obs()), **change})
    assert env.results()[0]["steps"] == 0


# -- several environments ----------------------------------------------------------------------------------------------


def test_the_running_list_shrinks() -> None:
    """Environments end one by one; the others go on, and answers come in the order asked for."""
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
    """An environment does the same alone and among others."""
    batch, single = _env(num_envs=2), _env()
    batch.reset([5, 6])
    single.reset([6])
    rng = np.random.default_rng(0)
    for _ in range(5):
        actions = [_random_action(rng), _random_action(rng)]
        batch.take_action_batch(actions, [0, 1])
        single.take_action(actions[1])
    assert batch.results()[1]["digest"] == single.results()[0]["digest"]


def test_last_frame_returns_the_observation_again() -> None:
    """Nothing is rendered a second time."""
    env = _env()
    env.reset([0])
    first = env.get_obs_batch()
    assert env.get_obs_batch(last_frame=True)[0] is first[0]
    env.take_action(_hold(first[0]))
    assert env.get_obs_batch()[0] is not first[0]


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"task": "lift_cub"}, "did you mean 'lift_cube'"),
        ({"embodiment": "franka"}, "unknown embodiment 'franka'"),
        ({"action_type": "velocity"}, "action_type"),
        ({"num_envs": 0}, "num_envs"),
        ({"cameras": [224]}, "cameras"),
        ({"camera": True}, "did you mean 'cameras'"),
    ],
)
def test_a_wrong_configuration_is_refused(config: Any, message: str) -> None:
    """One sentence says what is offered."""
    with pytest.raises(ValueError, match=message):
        _env(**config)


# -- tasks -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("action_type", spec.ACTION_TYPES)
def test_the_expert_solves_each_task(task: str, action_type: str) -> None:
    """Through the standard's interface, in both action types, with nothing clamped; the result tells the stages."""
    env = _env(task=task, action_type=action_type, privileged=True)
    for seed in (0, 1, 2):
        result = _solve(env, seed, action_type)
        assert result["success"], result
        assert result["score"] == 1.0
        assert all(result["stages"].values())
        assert result["corrections"] == {}


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("embodiment", FACTS["embodiments"])
@pytest.mark.parametrize("action_type", spec.ACTION_TYPES)
def test_the_expert_solves_a_hundred_seeds(task: str, embodiment: str, action_type: str) -> None:
    """Every embodiment, task and action type that is offered."""
    env = _env(task=task, embodiment=embodiment, action_type=action_type, privileged=True)
    failed = [seed for seed in range(100) if not _solve(env, seed, action_type, embodiment)["success"]]
    assert failed == []


@pytest.mark.parametrize("task", TASKS)
def test_doing_nothing_or_anything_solves_nothing(task: str) -> None:
    """Holding the pose and random joints fail every seed; holding earns no score at all."""
    for seed in range(3):
        env = _env(task=task)
        env.reset([seed])
        action = _hold(env.get_obs())
        while not env.is_episode_end():
            env.take_action(action)
        assert env.results()[0]["score"] == 0.0
        rng = np.random.default_rng(seed)
        env.reset([seed])
        while not env.is_episode_end():
            env.take_action(_random_action(rng))
        assert not env.results()[0]["success"]


def test_success_must_hold() -> None:
    """The goal is met for ten steps before the episode counts as solved."""
    env = _env(privileged=True)
    policy = Expert({"env_cfg_type": "arx_x5", "action_type": "joint"})
    env.reset([0])
    lifted_at = None
    while not env.is_episode_end():
        policy.update_obs(env.get_obs())
        report = env.take_action(policy.get_action()[0])
        if lifted_at is None and env.results()[0]["stages"]["lifted"]:
            lifted_at = report["step"]
    assert report["step"] - lifted_at >= FACTS["success"]["hold_steps"] - 1


def test_the_expert_says_what_it_lacks() -> None:
    """Without privileged observations there is one clear error."""
    env = _env()
    env.reset([0])
    policy = Expert({"env_cfg_type": "arx_x5"})
    policy.update_obs(env.get_obs())
    with pytest.raises(ObservationError, match="privileged"):
        policy.get_action()


def test_one_arm_works_too() -> None:
    """A single arm of the same model has unprefixed keys, its own camera set, and lifts the cube."""
    entry = {**get_embodiment("arx_x5").data, "arms": ["single"]}
    robot = _from_entry(entry)
    setup = episode_module.Setup(
        task="lift_cube",
        embodiment=robot,
        action_type="joint",
        max_steps=200,
        camera_size=(32, 32),
        privileged=True,
    )
    episode = episode_module.Episode(setup, seed=0, env_idx=0)
    obs = episode.observe()
    assert list(obs["vision"]) == list(spec.CAMERAS[1])
    assert set(robot.dims("joint")) <= set(obs["state"])
    policy = Expert({"env_cfg_type": "arx_x5", "action_type": "joint"})
    policy.embodiment = robot
    while episode.end_reason is None:
        policy.update_obs(episode.observe())
        episode.step(policy.get_action()[0])
    assert episode.end_reason == "success"


def test_every_stage_has_a_weight_and_they_add_up() -> None:
    """The manifest's weights of each task sum to one."""
    for facts in FACTS["tasks"].values():
        assert sum(facts["stages"].values()) == pytest.approx(1.0)


def test_pack_order_matches_control_order() -> None:
    """Commands reach the arm they name: moving the left joints leaves the right arm where it is."""
    env = _env()
    env.reset([0])
    obs = env.get_obs()
    action = _hold(obs)
    action["left_arm_joint_state"] = action["left_arm_joint_state"] + np.array([0.1, 0, 0, 0, 0, 0], dtype=np.float32)
    for _ in range(10):
        env.take_action(action)
    now = env.get_obs()
    assert np.allclose(now["state"]["left_arm_joint_state"], action["left_arm_joint_state"], atol=5e-3)
    before, after = (pack(seen["state"], get_embodiment("arx_x5"), "joint") for seen in (obs, now))
    assert np.abs(after[7:] - before[7:]).max() < 1e-4
