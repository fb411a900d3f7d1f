"""Safety between a policy and a robot: limits, age, values that are none, and loops that cannot do without it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.examples import examples
from xpl import _spec as spec
from xpl import get_embodiment, rotation
from xpl.action import ActionError, check_step, pack, unpack
from xpl.guard import GuardedEnv
from xpl.observation import ObservationError
from xpl.rollout import UnguardedError, run_batch, run_episode
from xpl.safety import FIRST_STEPS, Supervisor

RATE = 25.0
PERIOD = 1.0 / RATE
ROBOTS = ["arx_x5", "franka_single", "tianji_marvin_wuji"]
POSE = [0.3, 0.1, 0.9, 1.0, 0.0, 0.0, 0.0]


def _start(robot: str, control: str) -> dict[str, Any]:
    state = {}
    for arm in get_embodiment(robot).arms:
        middle = np.zeros(arm.dof) if arm.lower is None or arm.upper is None else (arm.lower + arm.upper) / 2
        state[f"{arm.prefix}arm_joint_state"] = middle.astype(np.float32)
        state[f"{arm.prefix}ee_pose"] = np.array(POSE, np.float32)
        state[f"{arm.prefix}ee_joint_state"] = np.ones(arm.ee_dim, np.float32)
    return {"state": state}


def _hold(robot: str, control: str) -> dict[str, Any]:
    """Return the action that commands the first pose."""
    state = _start(robot, control)["state"]
    return {key: state[key].copy() for key in get_embodiment(robot).dims(control)}


def _supervisor(robot: str = "arx_x5", control: str = "joint", **options: Any) -> Supervisor:
    made = Supervisor(get_embodiment(robot), control, RATE, **options)
    made.begin(_start(robot, control))
    return made


# -- the supervisor ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("control", spec.ACTION_TYPES)
def test_what_is_safe_passes_untouched(robot: str, control: str) -> None:
    supervisor = _supervisor(robot, control)
    action = _hold(robot, control)
    verdict = supervisor.check(action)
    assert verdict.action is action
    assert (verdict.corrections, verdict.hold_reason, verdict.ends) == ((), None, False)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("control", spec.ACTION_TYPES)
@settings(max_examples=examples(25), deadline=None)
@given(data=st.data())
def test_whatever_comes_what_is_executed_keeps_every_limit(robot: str, control: str, data: st.DataObject) -> None:
    embodiment = get_embodiment(robot)
    supervisor = _supervisor(robot, control, first_steps=math.inf)
    before = pack(_hold(robot, control), embodiment, control).astype(np.float64)
    for _ in range(4):
        flat = data.draw(st.lists(st.floats(-8, 8, width=32), min_size=len(before), max_size=len(before)))
        asked = unpack(np.array(flat, np.float32), embodiment, control)
        try:
            verdict = supervisor.check(asked)
        except ActionError:  # a quaternion without direction
            continue
        check_step(verdict.action, embodiment, control)
        done = pack(verdict.action, embodiment, control).astype(np.float64)
        now, then = unpack(done, embodiment, control), unpack(before, embodiment, control)
        for arm in embodiment.arms:
            if control == "joint":
                key = f"{arm.prefix}arm_joint_state"
                speed = spec.JOINT_SPEED if arm.velocity is None else arm.velocity
                assert (np.abs(now[key] - then[key]) <= speed * PERIOD + 1e-4).all()
                if arm.lower is not None and arm.upper is not None:
                    assert (now[key] >= arm.lower - 1e-4).all()
                    assert (now[key] <= arm.upper + 1e-4).all()
            else:
                key = f"{arm.prefix}ee_pose"
                assert np.linalg.norm(now[key][:3] - then[key][:3]) <= spec.POSITION_SPEED * PERIOD + 1e-4
                assert rotation.angle_between(now[key][3:], then[key][3:]) <= spec.ROTATION_SPEED * PERIOD + 2e-3
        changed = np.abs(done - pack(asked, embodiment, control)).max() > 1e-4
        assert bool(verdict.corrections) or not changed
        before = done


def test_a_correction_says_what_where_and_how_far() -> None:
    robot = get_embodiment("arx_x5")
    upper, speed = robot.arms[1].upper, robot.arms[1].velocity
    assert upper is not None
    assert speed is not None
    supervisor = _supervisor(first_steps=math.inf)
    action = _hold("arx_x5", "joint")
    start = float(action["right_arm_joint_state"][3])
    action["right_arm_joint_state"][3] = upper[3] + 0.25
    action["left_ee_joint_state"][0] = 1.5
    found = {(each.kind, each.prefix): each for each in supervisor.check(action).corrections}
    assert set(found) == {("joint_limit", "right_"), ("joint_speed", "right_"), ("gripper_range", "left_")}
    assert found["joint_limit", "right_"].where == "right_joint4"
    assert found["joint_limit", "right_"].amount == pytest.approx(0.25, abs=1e-5)
    assert found["joint_speed", "right_"].amount == pytest.approx((upper[3] - start) / PERIOD - speed[3], rel=1e-4)
    assert found["gripper_range", "left_"].where == "left_ee_joint_state"
    assert found["gripper_range", "left_"].amount == pytest.approx(0.5)


@pytest.mark.parametrize("control", spec.ACTION_TYPES)
def test_a_simulated_benchmark_may_execute_any_speed(control: str) -> None:
    """Commands keep the robot's limits, and move as far as its own evaluation lets them."""
    supervisor = _supervisor("aloha", control, first_steps=math.inf, fastest=math.inf)
    action = _hold("aloha", control)
    key = f"left_{'arm_joint_state' if control == 'joint' else 'ee_pose'}"
    action[key][0] += 1.0
    verdict = supervisor.check(action)
    assert verdict.action is action
    assert verdict.corrections == ()


def test_a_quaternion_of_another_length_is_repaired_and_told() -> None:
    supervisor = _supervisor("franka_single", "ee")
    action = {"ee_pose": np.array([*POSE[:3], 3.0, 0, 0, 0]), "ee_joint_state": [1.0]}
    verdict = supervisor.check(action)
    assert [(each.kind, each.amount) for each in verdict.corrections] == [("quaternion_norm", pytest.approx(2.0))]
    np.testing.assert_allclose(verdict.action["ee_pose"], POSE, rtol=1e-6)
    with pytest.raises(ActionError, match="unit quaternion"):
        supervisor.check({"ee_pose": np.array([*POSE[:3], 0, 0, 0, 0]), "ee_joint_state": [1.0]})


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("control", spec.ACTION_TYPES)
def test_a_value_that_is_none_holds_the_pose_and_ends_the_episode(bad: float, control: str) -> None:
    supervisor = _supervisor("arx_x5", control)
    first = _hold("arx_x5", control)
    key = next(iter(first))
    first[key][0] += 0.05
    supervisor.check(first)
    broken = _hold("arx_x5", control)
    broken[key][2] = bad
    verdict = supervisor.check(broken)
    assert (verdict.hold_reason, verdict.ends) == ("non_finite_action", True)
    assert (verdict.corrections[0].where, verdict.corrections[0].amount) == (key, 1.0)
    for name, values in first.items():
        np.testing.assert_allclose(verdict.action[name], values, atol=1e-6)


@pytest.mark.parametrize(("control", "key", "step"), [("joint", "arm_joint_state", 2.175), ("ee", "ee_pose", 2.5)])
def test_a_first_action_far_from_the_pose_is_refused(control: str, key: str, step: float) -> None:
    """Within three steps of full speed it is limited like any other; beyond, the arm does not move at all."""
    for steps, held in ((FIRST_STEPS - 0.1, None), (FIRST_STEPS + 0.1, "far_first_action")):
        supervisor = _supervisor("franka_single", control)
        action = _hold("franka_single", control)
        action[key][0] += steps * step * PERIOD
        verdict = supervisor.check(action)
        assert verdict.hold_reason == held
        moved = float(verdict.action[key][0] - _hold("franka_single", control)[key][0])
        assert moved == pytest.approx(0.0 if held else step * PERIOD, abs=1e-5)


def test_an_old_action_holds_the_pose_and_the_next_one_is_executed() -> None:
    action = _hold("arx_x5", "joint")
    for limit, age, held in (
        (None, 0.39, None),
        (None, 0.41, "action_age"),
        (1.0, 0.41, None),
        (0.1, 0.11, "action_age"),
    ):
        supervisor = _supervisor(max_age_s=limit)
        verdict = supervisor.check(action, age)
        assert (verdict.hold_reason, verdict.ends) == (held, False)
        assert supervisor.check(action, 0.0).hold_reason is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"left_arm_joint_state": np.zeros(5)}, r"shape \(6,\)"),
        ({"left_ee_pose": np.zeros(7)}, "left_ee_pose"),
    ],
)
def test_a_malformed_action_is_an_error(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ActionError, match=said):
        _supervisor().check({**_hold("arx_x5", "joint"), **change})


def test_a_supervisor_has_to_know_the_pose() -> None:
    robot = get_embodiment("arx_x5")
    with pytest.raises(RuntimeError, match="no episode has begun"):
        Supervisor(robot, "joint", RATE).check(_hold("arx_x5", "joint"))
    with pytest.raises(ObservationError, match="left_arm_joint_state"):
        Supervisor(robot, "joint", RATE).begin({"state": {}})
    with pytest.raises(ValueError, match=r"frequency=0\.0"):
        Supervisor(robot, "joint", 0.0)


# -- the guard ---------------------------------------------------------------------------------------------------------


class Arms:
    """Single Franka arms that execute whatever they are told, and a clock that every action lets go on."""

    def __init__(self, count: int = 1, steps: int = 8) -> None:
        self.now = 0.0
        self.told: list[tuple[int, float]] = []
        self._states = [_start("franka_single", "joint")["state"] for _ in range(count)]
        self._left = [steps] * count

    def clock(self) -> float:
        return self.now

    def reset(self, seed: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Nothing to do: an object plays one episode."""

    def get_obs(self) -> dict[str, Any]:
        return self.get_obs_batch([0])[0]

    def get_obs_batch(self, env_idx_list: Sequence[int]) -> list[dict[str, Any]]:
        return [{"state": dict(self._states[env])} for env in env_idx_list]

    def take_action_batch(self, actions: Sequence[Mapping[str, Any]], env_idx_list: Sequence[int]) -> None:
        self.now += PERIOD
        for env, action in zip(env_idx_list, actions, strict=True):
            self.told.append((env, float(action["arm_joint_state"][0])))
            self._states[env] = {**self._states[env], **action}
            self._left[env] -= 1

    def get_running_env_idx_list(self) -> list[int]:
        return [env for env, left in enumerate(self._left) if left > 0]

    def results(self) -> list[dict[str, Any]]:
        return [
            {"env_idx": env, "end_reason": "max_steps", "corrections": {"slip": 1}} for env in range(len(self._left))
        ]

    def close(self) -> None:
        """Nothing to release."""


class Planner:
    """A policy whose chunks move the first joint on by small steps; it may take its time, or answer nonsense."""

    def __init__(self, arms: Arms, chunk: int = 4, latency: Callable[[int], float] = lambda _ask: 0.0) -> None:
        self._arms, self._chunk, self._latency = arms, chunk, latency
        self.asked = 0
        self.calls: list[str] = []
        self.twist: dict[tuple[int, int], float] = {}
        self._shown: dict[int, Any] = {}

    def call(self, func_name: str, obs: Any = None) -> Any:
        self.calls.append(func_name)
        if func_name == "update_obs":
            self._shown[0] = obs
        elif func_name == "update_obs_batch":
            self._shown.update({each["env_idx"]: each for each in obs})
        elif func_name == "get_action":
            return self._chunks([0])[0]
        elif func_name == "get_action_batch":
            return self._chunks(obs)
        return None

    def _chunks(self, envs: Sequence[int]) -> list[list[dict[str, Any]]]:
        self._arms.now += self._latency(self.asked)
        self.asked += 1
        return [[self._action(env, step + 1) for step in range(self._chunk)] for env in envs]

    def _action(self, env: int, step: int) -> dict[str, Any]:
        state = self._shown[env]["state"]
        joints = state["arm_joint_state"].copy()
        joints[0] += self.twist.get((env, self.asked), 0.01) * step
        return {"arm_joint_state": joints, "ee_joint_state": state["ee_joint_state"]}


def _guarded(arms: Arms, **options: Any) -> GuardedEnv:
    robot = get_embodiment("franka_single")
    return GuardedEnv(arms, lambda: Supervisor(robot, "joint", RATE, **options), arms.clock)


def test_a_guarded_loop_does_what_is_safe_unchanged() -> None:
    arms = Arms()
    policy = Planner(arms, chunk=4)
    result = run_episode(_guarded(arms), policy, horizon=2)
    assert [round(angle, 4) for _, angle in arms.told] == [0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08]
    assert policy.asked == 4
    assert result == {"env_idx": 0, "end_reason": "max_steps", "corrections": {"slip": 1}, "safety": {}}


def test_a_chunk_that_came_too_late_is_not_executed_and_not_gone_on_with() -> None:
    """The pose is held once, the policy is asked anew; observing between the actions makes an old chunk no younger."""
    arms = Arms(steps=5)
    policy = Planner(arms, chunk=4, latency=lambda ask: 2.0 if ask == 1 else 0.1)
    result = run_episode(_guarded(arms), policy, horizon=2)
    assert [round(angle, 4) for _, angle in arms.told] == [0.01, 0.02, 0.02, 0.03, 0.04]
    assert policy.asked == 3
    assert result["corrections"] == {"slip": 1, "action_age": 1}
    entry = result["safety"]["action_age"]
    assert (entry["count"], entry["step"]) == (1, 3)
    assert entry["amount"] == pytest.approx(2.0 - 10 * PERIOD)


def test_the_steps_of_a_chunk_do_not_age_by_being_waited_for() -> None:
    """The last of sixty actions at 25 Hz is 2.4 s after its observation, as it was meant to be; a stall is noticed."""
    arms = Arms(steps=60)
    assert "action_age" not in run_episode(_guarded(arms), Planner(arms, chunk=60))["safety"]

    class Stalling(Arms):
        def get_obs_batch(self, env_idx_list: Sequence[int]) -> list[dict[str, Any]]:
            self.now += 5.0 if len(self.told) == 30 else 0.0
            return super().get_obs_batch(env_idx_list)

    stalling = Stalling(steps=60)
    entry = run_episode(_guarded(stalling), Planner(stalling, chunk=60))["safety"]["action_age"]
    assert (entry["count"], entry["step"]) == (1, 31)


def test_without_a_client_to_listen_to_age_counts_from_the_latest_observation() -> None:
    arms = Arms()
    env = _guarded(arms)
    obs = env.get_obs()
    action = {key: obs["state"][key] for key in ("arm_joint_state", "ee_joint_state")}
    arms.now += 1.0
    assert env.take_action(action)["hold_reason"] == "action_age"
    env.get_obs()
    assert env.take_action(action)["hold_reason"] is None


@pytest.mark.parametrize(("twist", "reason"), [(math.nan, "non_finite_action"), (1.0, "far_first_action")])
def test_one_environment_is_stopped_and_the_others_go_on(twist: float, reason: str) -> None:
    arms = Arms(count=3, steps=4)
    policy = Planner(arms, chunk=2)
    policy.twist[1, 1] = twist
    results = run_batch(_guarded(arms), policy)
    assert [result["end_reason"] for result in results] == ["max_steps", reason, "max_steps"]
    assert [angle for env, angle in arms.told if env == 1] == [0.0]
    assert len([env for env, _ in arms.told if env != 1]) == 8
    assert results[1]["safety"][reason]["count"] == 1


def test_a_wild_step_is_limited_and_counted() -> None:
    arms = Arms(steps=2)
    policy = Planner(arms, chunk=1)
    policy.twist[0, 2] = 10.0
    result = run_episode(_guarded(arms), policy)
    limit = get_embodiment("franka_single").arms[0].velocity
    assert limit is not None
    assert arms.told[1][1] == pytest.approx(0.01 + limit[0] * PERIOD, abs=1e-5)
    assert result["safety"]["joint_limit"]["where"] == "joint1"
    assert result["corrections"] == {"slip": 1, "joint_limit": 1, "joint_speed": 1}


def test_a_malformed_action_moves_nobody() -> None:
    arms = Arms(count=2)
    env = _guarded(arms)
    good = {key: values for key, values in _start("franka_single", "joint")["state"].items() if key != "ee_pose"}
    with pytest.raises(ActionError, match="lacks"):
        env.take_action_batch([good, {"arm_joint_state": good["arm_joint_state"]}], [0, 1])
    assert arms.told == []


def test_no_loop_of_ours_drives_what_nobody_guards() -> None:
    arms = Arms()
    policy = Planner(arms)
    for run in (run_episode, run_batch):
        with pytest.raises(UnguardedError, match="GuardedEnv"):
            run(arms, policy)
    assert (policy.calls, arms.told) == ([], [])
