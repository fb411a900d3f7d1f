"""Forward and inverse kinematics agree with each other, with MuJoCo and with the limits."""

from typing import Any

import numpy as np
import pytest

from tests.support.work import calls
from xpl import get_embodiment, robots, rotation
from xpl.kinematics import Chain, KinematicsError
from xpl.poses import compose, invert, pose, transform
from xpl.robots import shipped
from xpl_cli.basics.content import content_folder, load_module

DRIVEN = sorted({"franka", *load_module(content_folder("envs") / "mujoco" / "manifest.py").manifest().embodiments})
KNOWN = sorted(name for name, entry in shipped.entries().items() if robots.has_frames(entry))


@pytest.fixture(params=KNOWN)
def chain(request: pytest.FixtureRequest) -> Chain:
    return Chain.from_embodiment(robots.entries()[request.param])


def _random_joints(chain: Chain, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(chain.lower, chain.upper)


@pytest.mark.parametrize("name", DRIVEN)
def test_forward_kinematics_agrees_with_mujoco(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    folder = content_folder("envs") / "mujoco"
    facts = load_module(folder / "manifest.py").manifest().data
    embodiment = get_embodiment(name)
    scene = load_module(folder / "scene.py").build_scene(embodiment, facts)
    physics = load_module(folder / "physics.py").Physics(scene)
    chain, rng = Chain.from_embodiment(embodiment.data), np.random.default_rng(0)
    for _ in range(20):
        for arm, (names, base) in enumerate(zip(scene.arms, scene.bases, strict=True)):
            joints = _random_joints(chain, rng)
            physics.place(arm, joints, 0.5)
            mujoco.mj_kinematics(physics.model, physics.data)
            for site, expected in ((names.flange, chain.flange(joints)), (names.tcp, chain.tcp(joints))):
                found = physics.data.site(site)
                world = compose(base, expected)
                assert np.abs(world[:3] - found.xpos).max() < 1e-6
                assert np.abs(rotation.to_matrix(world[3:]) - found.xmat.reshape(3, 3)).max() < 1e-6
            assert np.abs(physics.tcp(arm)[:3] - physics.data.site(names.tcp).xpos).max() < 1e-6


@pytest.mark.parametrize("name", KNOWN)
def test_a_model_of_the_same_numbers_stands_where_the_kinematics_says(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    entry = robots.entries()[name]
    made = mujoco.MjSpec()
    made.compiler.degree, made.compiler.eulerseq = False, "XYZ"  # about axes that stand still, as URDF has it
    body = made.worldbody
    for place, joint in enumerate(entry["arm"]["joints"]):
        body = _turned(mujoco, body.add_body(name=f"link{place}", pos=joint["origin"]["xyz"]), joint["origin"]["rpy"])
        body.add_joint(name=joint["name"], axis=joint["axis"], type=mujoco.mjtJoint.mjJNT_HINGE)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0])
    tcp = entry["end_effector"]["tcp"]
    if tcp is not None:
        _turned(mujoco, body.add_site(name="tcp", pos=tcp["xyz"]), tcp["rpy"])
    model = made.compile()
    data, chain, rng = mujoco.MjData(model), Chain.from_embodiment(entry), np.random.default_rng(4)
    for _ in range(10):
        data.qpos[:] = joints = _random_joints(chain, rng)
        mujoco.mj_kinematics(model, data)
        assert np.abs(chain.points(joints)[:-1] - data.xpos[1:]).max() < 1e-6
        seen = [(chain.flange(joints), data.xpos[-1], data.xmat[-1])]
        if tcp is not None:
            seen.append((chain.tcp(joints), data.site("tcp").xpos, data.site("tcp").xmat))
        for told, position, matrix in seen:
            assert np.abs(told[:3] - position).max() < 1e-6
            assert np.abs(rotation.to_matrix(told[3:]) - matrix.reshape(3, 3)).max() < 1e-6


def _turned(mujoco: Any, item: Any, rpy: list[float]) -> Any:
    item.alt.type, item.alt.euler = mujoco.mjtOrientation.mjORIENTATION_EULER, rpy
    return item


def test_warm_started_solutions_reach_their_target(chain: Chain) -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        joints = _random_joints(chain, rng)
        start = joints + rng.normal(0.0, 0.05, chain.dof)
        solution = chain.solve(chain.flange(joints), start)
        reached = chain.flange(solution.joints)
        assert solution.converged
        assert np.abs(reached[:3] - chain.flange(joints)[:3]).max() <= 1e-5
        assert rotation.angle_between(reached[3:], chain.flange(joints)[3:]) <= 1e-4
        assert np.all((solution.joints >= chain.lower) & (solution.joints <= chain.upper))


@pytest.mark.sampled(9)
def test_search_finds_what_is_far_from_the_start(chain: Chain) -> None:
    rng = np.random.default_rng(3)
    middle = 0.5 * (chain.lower + chain.upper)
    found = [chain.search(chain.flange(_random_joints(chain, rng)), middle, attempts=16).converged for _ in range(40)]
    assert np.mean(found) >= 0.95


def test_a_pose_that_holds_is_left_alone(chain: Chain) -> None:
    joints = 0.5 * (chain.lower + chain.upper)
    solution = chain.solve(chain.flange(joints), joints)
    assert solution.iterations == 0
    assert np.array_equal(solution.joints, joints)


def test_the_sign_of_a_quaternion_does_not_matter(chain: Chain) -> None:
    joints = 0.4 * chain.lower + 0.6 * chain.upper
    target = chain.flange(joints + 0.02)
    flipped = pose(target[:3], -target[3:])
    start = joints.copy()
    assert np.allclose(chain.solve(target, start).joints, chain.solve(flipped, start).joints, atol=1e-12)


def test_a_pose_out_of_reach_is_reported(chain: Chain) -> None:
    middle = 0.5 * (chain.lower + chain.upper)
    target = pose([2.0, 0.0, 0.3], chain.flange(middle)[3:])
    solution = chain.solve(target, middle)
    assert not solution.converged
    gap = np.sqrt(np.sum((chain.flange(solution.joints)[:3] - target[:3]) ** 2))
    assert np.isclose(solution.position_error, gap)
    assert 0.5 < gap < np.sqrt(np.sum((chain.flange(middle)[:3] - target[:3]) ** 2))


def test_solving_is_fast_enough_for_control(chain: Chain) -> None:
    """A warm solve takes three steps at most, of as many calls as are made in well under a millisecond."""
    joints = 0.45 * chain.lower + 0.55 * chain.upper
    if chain.names[0] == "right_j0":
        joints = chain.home  # Sawyer's elbow is stretched in the middle of its limits
    target = chain.flange(joints + 0.02)
    chain.solve(target, joints)
    solution, count = calls(lambda: chain.solve(target, joints))
    assert solution.iterations <= 3
    assert count < 800  # 500 take 0.3 ms


def test_frames_compose_and_invert() -> None:
    rng = np.random.default_rng(4)
    a = pose(rng.normal(size=(6, 3)), rotation.normalise(rng.normal(size=(6, 4))))
    b = pose(rng.normal(size=3), rotation.normalise(rng.normal(size=4)))
    assert np.allclose(compose(a, invert(a))[:, :3], 0.0, atol=1e-12)
    assert np.allclose(compose(invert(a), compose(a, b))[:, :3], b[:3], atol=1e-12)
    point = rng.normal(size=3)
    assert np.allclose(transform(compose(a, b), point), transform(a, transform(b, point)), atol=1e-12)


def test_dimensions_without_frames_have_no_kinematics() -> None:
    with pytest.raises(KinematicsError, match="tianji_marvin_wuji"):
        Chain.from_embodiment(shipped.entries()["tianji_marvin_wuji"])


@pytest.mark.parametrize("bad", [[0.0] * 5, [np.nan] * 6])
def test_malformed_joints_are_refused(bad: Any) -> None:
    with pytest.raises(KinematicsError, match="6 finite numbers"):
        Chain.from_embodiment(shipped.entries()["arx_x5"]).flange(bad)
