from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tests.support.examples import examples
from xpl import _spec as spec
from xpl.action import ActionError, check_chunk
from xpl.embodiment import UnknownEmbodimentError
from xpl.observation import ObservationError
from xpl.policy import ConfigError, Policy, PolicyStateError

CHUNK, HISTORY, DIM = 2, 3, 8


def config(**changes: Any) -> dict[str, Any]:
    temporal = {"kind": "history", "chunk": CHUNK, "history": HISTORY}
    return {"env_cfg_type": "franka_single", "action_type": "joint", "manifest": {"temporal": temporal}, **changes}


def observed(number: int, env: int | None = None) -> dict[str, Any]:
    return {"number": number} if env is None else {"number": number, "env_idx": env}


class Tracing(Policy):
    def load(self, config: Any) -> None:
        self.encoded: list[tuple[int, int]] = []
        self.forgotten: list[int] = []
        self.batches: list[list[int]] = []

    def encode(self, obs: Any, env: int) -> int:
        self.encoded.append((obs["number"], env))
        return int(obs["number"])

    def predict(self, inputs: list[Any], envs: list[int]) -> np.ndarray:
        """Return rows of [history..., environment, random number, 0, 0, gripper]."""
        self.batches.append(list(envs))
        numbers = inputs if self.history > 1 else [[number] for number in inputs]
        raw = np.zeros((len(envs), self.chunk or 1, DIM))
        for row, seen, env in zip(raw, numbers, envs, strict=True):
            row[:, : len(seen)] = seen
            row[:, 4] = env
            row[:, 5] = self.rng(env).random()
        return raw

    def reset_env(self, env: int) -> None:
        self.forgotten.append(env)


def rows(chunk: list[dict[str, np.ndarray]]) -> np.ndarray:
    return np.array([step["arm_joint_state"] for step in chunk])


class Memory(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.policy = Tracing(config())
        self.seen: dict[int, list[int]] = {}
        self.order: list[int] | None = None
        self.episode = 0
        self.count = 0

    def fresh(self, env: int) -> int:
        self.count += 1
        self.seen.setdefault(env, []).append(self.count)
        return self.count

    def expected(self, env: int) -> list[int]:
        """Return the history that predict must see: the newest ones, padded with the oldest of them."""
        last = self.seen[env][-HISTORY:]
        return [last[0]] * (HISTORY - len(last)) + last

    def check(self, chunks: list[Any], envs: list[int]) -> None:
        assert len(chunks) == len(envs)
        for chunk, env in zip(chunks, envs, strict=True):
            check_chunk(chunk, self.policy.embodiment, "joint")
            assert len(chunk) == CHUNK
            assert rows(chunk)[:, :3].tolist() == [self.expected(env)] * CHUNK
            assert rows(chunk)[0, 4] == env

    @rule(env=st.none() | st.integers(0, 3))
    def observe_one(self, env: int | None) -> None:
        self.policy.update_obs(observed(self.fresh(env or 0), env))
        self.order = [env or 0]

    @rule(envs=st.lists(st.integers(0, 3), unique=True))
    def observe_batch(self, envs: list[int]) -> None:
        self.policy.update_obs_batch([observed(self.fresh(env), env) for env in envs])
        self.order = envs

    @rule(count=st.integers(0, 3))
    def observe_by_position(self, count: int) -> None:
        self.policy.update_obs_batch([observed(self.fresh(env)) for env in range(count)])
        self.order = list(range(count))

    @rule(bad=st.sampled_from([[0, 0], [1, None], [True], [-1], [0.5]]))
    def observe_wrongly(self, bad: list[Any]) -> None:
        with pytest.raises(ObservationError):
            self.policy.update_obs_batch([{"number": -1, "env_idx": env} for env in bad])

    @rule()
    def act_on_the_last_batch(self) -> None:
        if self.order is None:
            with pytest.raises(PolicyStateError, match="needs an observation"):
                self.policy.get_action_batch()
        else:
            self.check(self.policy.get_action_batch(), self.order)

    @rule()
    def act_alone(self) -> None:
        if self.order is not None and len(self.order) == 1:
            self.check([self.policy.get_action()], self.order)
        else:
            with pytest.raises(PolicyStateError, match="get_action"):
                self.policy.get_action()

    @rule(envs=st.lists(st.integers(0, 4), max_size=4))
    def act_for_some(self, envs: list[int]) -> None:
        """Exactly those, in that order; [] is answered by []; unknown and repeated ones are errors."""
        if len(set(envs)) != len(envs) or not set(envs) <= set(self.seen):
            with pytest.raises(PolicyStateError, match=r"repeated|has no observation"):
                self.policy.get_action_batch(envs)
        else:
            self.check(self.policy.get_action_batch(envs), envs)

    @rule()
    def reset(self) -> None:
        """The episode counts only if something was observed in it."""
        self.policy.forgotten.clear()
        self.policy.reset()
        assert sorted(self.policy.forgotten) == sorted(self.seen)
        self.episode += bool(self.seen)
        self.seen, self.order = {}, None

    @precondition(lambda self: self.seen)
    @rule()
    def random_numbers_belong_to_seed_episode_and_environment(self) -> None:
        env = next(iter(self.seen))
        fresh = np.random.default_rng([0, self.episode, env]).bit_generator.state["state"]["inc"]
        assert self.policy.rng(env).bit_generator.state["state"]["inc"] == fresh

    @invariant()
    def memory_is_bounded(self) -> None:
        assert all(len(state.frames) <= HISTORY for state in self.policy._environments.values())


TestMemory = Memory.TestCase
TestMemory.settings = settings(max_examples=examples(60), stateful_step_count=30, deadline=None)


def episode(policy: Policy, envs: list[int], steps: int, *, batch: bool) -> dict[int, list[np.ndarray]]:
    chunks: dict[int, list[np.ndarray]] = {env: [] for env in envs}
    for step in range(steps):
        observations = [observed(10 * step + env, env) for env in envs]
        if batch:
            policy.update_obs_batch(observations)
            for env, chunk in zip(envs, policy.get_action_batch(envs), strict=True):
                chunks[env].append(rows(chunk))
        else:
            for env, obs in zip(envs, observations, strict=True):
                policy.update_obs(obs)
                chunks[env].append(rows(policy.get_action()))
    return chunks


@pytest.mark.parametrize("ensembling", [None, 0.1])
def test_a_batch_acts_like_single_runs(ensembling: float | None) -> None:
    temporal = {"chunk": CHUNK, "history": HISTORY, "ensembling": ensembling}
    settings_ = config(manifest={"temporal": temporal})
    alone = episode(Tracing(settings_), [0, 1, 2], 5, batch=False)
    together = episode(Tracing(settings_), [2, 0, 1], 5, batch=True)
    for env in alone:
        assert np.array_equal(alone[env], together[env])


def test_equal_seeds_repeat_and_others_do_not() -> None:
    def numbers(seed: int | None, episodes: int) -> list[list[float]]:
        policy = Tracing(config(seed=seed))
        result = []
        for _ in range(episodes):
            chunks = episode(policy, [0, 1], 1, batch=True)
            result.append([float(chunks[env][0][0, 5]) for env in (0, 1)])
            policy.reset()
            policy.reset()
        return result

    first = numbers(0, 3)
    assert numbers(0, 3) == first
    assert numbers(None, 3) == first
    assert numbers(-5, 1) == numbers(-5, 1)
    everything = {number for run in (first, numbers(1, 3), numbers(-5, 3)) for pair in run for number in pair}
    assert len(everything) == 18


def test_asking_twice_is_answered_twice_and_encodes_once() -> None:
    policy = Tracing(config())
    for number in range(5):
        policy.update_obs(observed(number))
        policy.get_action()
        policy.get_action()
    assert policy.encoded == [(number, 0) for number in range(5)]


def test_observations_are_not_changed() -> None:
    """They may be shared with the simulator."""
    policy = Tracing(config())
    obs = observed(1, 0)
    before = copy.deepcopy(obs)
    policy.update_obs(obs)
    policy.get_action()
    assert obs == before


def test_one_forward_pass_serves_a_batch() -> None:
    policy = Tracing(config())
    policy.update_obs_batch([observed(env, env) for env in (3, 1, 2)])
    policy.get_action_batch([2, 3])
    policy.get_action_batch([])
    assert policy.batches == [[2, 3]]


def test_model_io_state_is_forgotten_before_the_first_observation_and_at_reset() -> None:
    policy = Tracing(config())
    policy.update_obs(observed(1, 4))
    policy.update_obs(observed(2, 4))
    assert policy.forgotten == [4]
    policy.reset()
    policy.reset()
    assert policy.forgotten == [4, 4]


def test_a_reset_that_fails_raises() -> None:
    class Fragile(Tracing):
        fails: bool

        def reset_env(self, env: int) -> None:
            if self.fails:
                raise RuntimeError("model_io reset failed")

    policy = Fragile(config())
    policy.fails = False
    policy.update_obs(observed(1))
    policy.fails = True
    with pytest.raises(RuntimeError, match="model_io reset failed"):
        policy.reset()
    with pytest.raises(PolicyStateError):
        policy.get_action()


CLIENT = spec.LIMITS["client_envs"]


def test_reset_envs_ends_the_episode_of_these_environments_only() -> None:
    policy = Tracing(config())
    policy.update_obs_batch([observed(number, env) for number, env in ((1, 0), (2, 1), (3, CLIENT))])
    policy.forgotten.clear()
    policy.reset_envs([1, 5, 0])
    assert policy.forgotten == [1, 0]
    with pytest.raises(PolicyStateError, match="needs an observation"):
        policy.get_action_batch()
    with pytest.raises(PolicyStateError, match="environment 0 has no observation"):
        policy.get_action_batch([0])
    policy.update_obs(observed(4, CLIENT))
    policy.reset_envs([])
    policy.reset_envs([0, 1])
    assert rows(policy.get_action())[0, :3].tolist() == [3, 3, 4]


def test_a_forward_pass_that_fails_leaves_the_random_generators_where_they_were() -> None:
    class Failing(Tracing):
        fails = False

        def decode(self, raw: np.ndarray, obs: Any, env: int) -> Any:
            if self.fails and env == 2:
                raise ValueError("not this one")
            return super().decode(raw, obs, env)

    policy, untroubled = Failing(config()), Tracing(config())
    for one in (policy, untroubled):
        one.update_obs_batch([observed(env, env) for env in range(3)])
    policy.fails = True
    with pytest.raises(ValueError, match="not this one"):
        policy.get_action_batch()
    policy.fails = False
    for chunk, expected in zip(policy.get_action_batch([1, 0]), untroubled.get_action_batch([1, 0]), strict=True):
        assert rows(chunk).tolist() == rows(expected).tolist()


class Fixed(Policy):
    answer: Any = None

    def encode(self, obs: Any, env: int) -> None:
        """Look at nothing."""

    def predict(self, inputs: list[Any], envs: list[int]) -> Any:
        return self.answer


def act(answer: Any, **temporal: Any) -> list[Any]:
    policy = Fixed(config(manifest={"temporal": temporal}))
    policy.answer = answer
    policy.update_obs({})
    return policy.get_action()


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "predict must return"),
        (3.0, "predict must return"),
        ({}, "predict must return"),
        ([], "one chunk per environment: expected 1, got 0"),
        (np.zeros((2, 4, DIM)), "one chunk per environment: expected 1, got 2"),
        (np.zeros((1, DIM)), r"\(H, D\)"),
        (np.zeros((1, 3, DIM)), "declares chunks of 4 steps, this one has 3"),
        (np.zeros((1, 4, DIM + 1)), "rows of 8"),
        (np.full((1, 4, DIM), np.nan), "NaN"),
    ],
)
def test_a_wrong_prediction_is_refused_with_the_difference(answer: Any, message: str) -> None:
    with pytest.raises(ActionError, match=message):
        act(answer, chunk=4)


def test_predictions_may_be_arrays_lists_or_nested_lists() -> None:
    for answer in (np.zeros((1, 4, DIM)), [np.zeros((4, DIM))], [[[0.0] * DIM] * 4]):
        assert len(act(answer, chunk=4)) == 4
    assert len(act(np.zeros((1, 9, DIM)))) == 9  # nothing declared


def test_the_declared_chunk_is_what_a_call_returns() -> None:
    class Cut(Fixed):
        def decode(self, raw: np.ndarray, obs: Any, env: int) -> Any:
            return super().decode(raw[:2], obs, env)

    policy = Cut(config(manifest={"temporal": {"chunk": 2}}))
    policy.answer = np.zeros((1, 16, DIM))
    policy.update_obs({})
    assert len(policy.get_action()) == 2


def test_ensembling_averages_actions_and_not_what_the_model_emits() -> None:
    """A model of deltas: the same target from two states must stay where it is."""

    class Deltas(Fixed):
        def decode(self, raw: np.ndarray, obs: Any, env: int) -> Any:
            return super().decode(raw + obs["at"], obs, env)

    policy = Deltas(config(manifest={"temporal": {"chunk": 2, "ensembling": 0.0}}))
    for at in (0.0, 0.25):
        policy.answer = np.full((1, 2, DIM), 0.5 - at)
        policy.update_obs({"at": at})
        assert rows(policy.get_action()) == pytest.approx(0.5)


def test_ensembling_of_poses_ignores_the_sign_of_quaternions() -> None:
    policy = Fixed(config(action_type="ee", manifest={"temporal": {"chunk": 2, "ensembling": 0.0}}))
    for sign in (1.0, -1.0, 1.0):
        policy.answer = np.array([[[0, 0, 0, sign, 0, 0, 0, 0.5]] * 2])
        policy.update_obs({})
        assert np.abs(policy.get_action()[0]["ee_pose"]).tolist() == [0, 0, 0, 1, 0, 0, 0]


# -- configuration -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "default", "result"),
    [
        (None, True, True),
        (False, True, False),
        (3, 1.5, 3.0),
        (0, 5, 0),
        (None, None, None),
        ("x", None, "x"),
        ([1], [], [1]),
    ],
)
def test_a_setting_keeps_its_type(value: Any, default: Any, result: Any) -> None:
    got = Tracing(config(key=value)).setting("key", default)
    assert (got, type(got)) == (result, type(result))


@pytest.mark.parametrize(
    ("value", "default"), [("false", True), (1, True), (True, 1), (True, 1.0), ("3", 3), (3.0, 3), (3, "x"), ({}, [])]
)
def test_a_setting_of_another_type_is_an_error(value: Any, default: Any) -> None:
    with pytest.raises(ConfigError, match="key must be a"):
        Tracing(config(key=value)).setting("key", default)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"action_type": "qpos"}, ConfigError),
        ({"env_cfg_type": None}, ConfigError),
        ({"env_cfg_type": 3}, ConfigError),
        ({"env_cfg_type": "arx_x6"}, UnknownEmbodimentError),
        ({"seed": "0"}, ConfigError),
        ({"seed": True}, ConfigError),
    ],
)
def test_a_wrong_configuration_is_refused_at_construction(change: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        Tracing(config(**change))


@pytest.mark.parametrize(
    ("declared", "said"),
    [
        ({"embodiments": ["arx_x5", "piper"]}, "embodiments arx_x5, piper, got env_cfg_type: franka_single"),
        ({"embodiments": ["franka_single"], "action_types": ["ee"]}, "the action types ee, got action_type: joint"),
    ],
)
def test_what_the_manifest_does_not_declare_is_refused(declared: dict[str, Any], said: str) -> None:
    """A model that was made for other robots would move this one somehow."""
    with pytest.raises(ConfigError, match=said):
        Tracing(config(manifest=declared))


def test_a_declared_robot_may_go_by_another_name() -> None:
    for asked, declared in (("dual_x5", "arx_x5"), ("arx_x5", "dual_x5")):
        manifest = {"embodiments": [declared], "action_types": ["joint"]}
        assert Tracing(config(env_cfg_type=asked, manifest=manifest)).embodiment.name == "arx_x5"


def test_null_means_the_default() -> None:
    policy = Tracing(config(seed=None, action_type=None, manifest=None))
    assert (policy.seed, policy.action_type, policy.chunk, policy.history) == (0, "joint", None, 1)
    assert "manifest" not in policy.config


def test_the_policy_folder_is_the_modules() -> None:
    assert Tracing(config()).policy_dir.name == "sdk"


def test_what_an_adapter_must_define_is_named() -> None:
    policy = Policy(config())
    policy.update_obs({})
    with pytest.raises(NotImplementedError, match=r"must define encode\(obs, env\)"):
        policy.get_action()
