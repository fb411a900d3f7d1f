"""Several clients and one model: each must get exactly what it would get if it were alone with a model of its own."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.examples import examples
from xpl import _spec as spec
from xpl.observation import ObservationError
from xpl.policy import Policy, PolicyStateError
from xpl.worker.sharing import SharedModel, SharedRequest

SPAN = spec.LIMITS["client_envs"]
TEMPORAL = {"chunk": 3, "history": 2, "ensembling": 0.1}


class Stochastic(Policy):
    """Answers by its history and a random number, and fails on request, early or late."""

    def load(self, config: Mapping[str, Any]) -> None:
        self.batches: list[list[int]] = []
        self.forgotten: list[int] = []

    def encode(self, obs: Mapping[str, Any], env: int) -> dict[str, Any]:
        if obs.get("fail") == "encode":
            raise ValueError("no image")
        return {"n": obs["n"], "fail": obs.get("fail")}

    def predict(self, inputs: list[Any], envs: list[int]) -> np.ndarray:
        self.batches.append(list(envs))
        raw = np.zeros((len(envs), 3, 8))
        for row, frames, env in zip(raw, inputs, envs, strict=True):
            row[:, 0], row[:, 1] = frames[0]["n"], frames[-1]["n"]
            row[:, 2:7] = self.rng(env).random((3, 5))
            if frames[-1]["fail"] == "nan":
                row[0, 0] = np.nan
            if frames[-1]["fail"] == "exit":
                sys.exit(2)
        return raw

    def reset_env(self, env: int) -> None:
        self.forgotten.append(env)


def model() -> Stochastic:
    return Stochastic({"env_cfg_type": "franka_single", "seed": 5, "manifest": {"temporal": TEMPORAL}})


def observed(number: float, env: int | None = None, **more: Any) -> dict[str, Any]:
    return {"n": number, **more} if env is None else {"n": number, "env_idx": env, **more}


def plain(result: Any) -> Any:
    if isinstance(result, BaseException):
        return type(result).__name__, str(result)
    if isinstance(result, np.ndarray):
        return result.tolist()
    if isinstance(result, dict):
        return {key: plain(value) for key, value in result.items()}
    return [plain(item) for item in result] if isinstance(result, list) else result


def alone(policy: Policy, method: str, argument: Any) -> Any:
    """Return what a client gets that has a model of its own, as the worker runs it, or the exception."""
    try:
        if method == "infer" or (method == "get_action" and argument is not None):
            policy.update_obs(argument)
            return policy.get_action()
        if method in {"reset", "get_action"}:
            return getattr(policy, method)()
        return getattr(policy, method)(argument)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - the outcome
        return error


# -- as if each were alone ---------------------------------------------------------------------------------------------

NUMBERS = st.integers(0, 9)
ENVS = st.integers(0, 2)
FAILURES = st.sampled_from([None] * 6 + ["encode", "nan", "exit"])
SINGLE = st.builds(lambda n, env, fail: observed(n, env, fail=fail), NUMBERS, ENVS, FAILURES)
BATCH = st.lists(ENVS, min_size=1, max_size=3, unique=True).flatmap(
    lambda envs: st.lists(NUMBERS, min_size=len(envs), max_size=len(envs)).map(
        lambda numbers: [observed(n, env) for n, env in zip(numbers, envs, strict=True)]
    )
)
OPERATIONS = (
    st.tuples(st.sampled_from(["infer", "update_obs", "get_action"]), SINGLE)
    | st.tuples(st.just("update_obs_batch"), BATCH)
    | st.tuples(st.sampled_from(["get_action", "get_action_batch", "reset"]), st.none())
    | st.tuples(st.just("get_action_batch"), st.lists(ENVS, max_size=3))
)
ROUNDS = st.lists(st.dictionaries(st.integers(0, 3), OPERATIONS, min_size=1), max_size=8)


@settings(max_examples=examples(150), deadline=None)
@given(ROUNDS)
def test_interleaved_clients_get_what_each_alone_would_get(rounds: list[dict[int, tuple[str, Any]]]) -> None:
    together = SharedModel(model())
    own: dict[int, Stochastic] = {}
    for operations in rounds:
        results = together.run([SharedRequest(client, *operation) for client, operation in operations.items()])
        for (client, (method, argument)), result in zip(operations.items(), results, strict=True):
            expected = alone(own.setdefault(client, model()), method, argument)
            if isinstance(expected, BaseException):
                assert type(result) is type(expected)
            else:
                assert plain(result) == plain(expected)


def test_those_who_ask_at_once_are_answered_by_one_forward_pass() -> None:
    policy = model()
    shared = SharedModel(policy)
    shared.run([SharedRequest(client, "update_obs", observed(client)) for client in range(3)])
    shared.run([SharedRequest(1, "update_obs_batch", [observed(4, 7), observed(5, 2)])])
    chunks = shared.run(
        [
            SharedRequest(2, "get_action"),
            SharedRequest(0, "infer", observed(6, 1)),
            SharedRequest(1, "get_action_batch", [2, 7]),
        ]
    )
    assert policy.batches == [[2 * SPAN, 1, SPAN + 2, SPAN + 7]]
    assert [len(chunk) for chunk in chunks] == [3, 3, 2]
    assert [chunk[0]["arm_joint_state"][1] for chunk in chunks[2]] == [5, 4]


def test_the_number_of_an_environment_is_all_that_changes_in_an_observation() -> None:
    policy = model()
    given_one = observed(3, 1)
    SharedModel(policy).run([SharedRequest(2, "update_obs", given_one)])
    assert given_one == {"n": 3, "env_idx": 1}


# -- failures ----------------------------------------------------------------------------------------------------------


class Wayward:
    answer: Any = None

    def update_obs_batch(self, obs_list: Sequence[Any]) -> None:
        """Look at nothing."""

    def get_action_batch(self, env_idx_list: Sequence[int]) -> Any:
        return self.answer

    def reset_envs(self, env_idx_list: Sequence[int]) -> None:
        """Keep nothing."""


@pytest.mark.parametrize(
    ("answer", "says"), [([["a"]], "1 chunks for 2 environments"), (None, "not iterable"), (3, "not iterable")]
)
def test_a_batch_of_another_length_is_an_error(answer: Any, says: str) -> None:
    wayward = Wayward()
    wayward.answer = answer
    shared = SharedModel(wayward)
    shared.run([SharedRequest(0, "update_obs_batch", [observed(1, 0), observed(1, 1)])])
    (result,) = shared.run([SharedRequest(0, "get_action_batch")])
    assert says in str(result)


def test_any_iterable_of_chunks_is_taken() -> None:
    wayward = Wayward()
    wayward.answer = (chunk for chunk in ["a", "b"])
    shared = SharedModel(wayward)
    shared.run([SharedRequest(0, "update_obs_batch", [observed(1, 0), observed(1, 1)])])
    assert shared.run([SharedRequest(0, "get_action_batch")]) == [["a", "b"]]


@pytest.mark.parametrize(
    ("method", "argument", "error", "says"),
    [
        ("get_action", None, PolicyStateError, "needs an observation"),
        ("get_action_batch", None, PolicyStateError, "needs an observation"),
        ("get_action_batch", [0], PolicyStateError, r"environments \[0\] have no observation"),
        ("get_action_batch", [-1], ObservationError, "non-negative"),
        ("get_action_batch", ["0"], ObservationError, "non-negative"),
        ("update_obs", observed(0, SPAN), ObservationError, f"below {SPAN}"),
        ("update_obs", observed(0, -1), ObservationError, "non-negative"),
        ("infer", {"n": 0, "env_idx": False}, ObservationError, "non-negative"),
        ("update_obs_batch", [observed(0, 1), observed(0, 1)], ObservationError, "repeated"),
        ("update_obs_batch", [observed(0, 1), observed(0)], ObservationError, "either all"),
    ],
)
def test_what_has_no_answer_is_an_error(method: str, argument: Any, error: type[Exception], says: str) -> None:
    shared = SharedModel(model())
    shared.run([SharedRequest(0, "update_obs_batch", [observed(0, env) for env in range(3)])])
    (result,) = shared.run([SharedRequest(1, method, argument)])
    with pytest.raises(error, match=says):
        raise result


def test_environments_are_told_in_the_clients_own_numbers() -> None:
    shared = SharedModel(model())
    shared.run([SharedRequest(3, "update_obs_batch", [observed(0, 4), observed(1, 5)])])
    for method, argument, says in [
        ("get_action_batch", [4, 4], r"repeated in \[4, 4\]"),
        ("get_action_batch", [4, 6], r"environments \[6\]"),
        ("get_action", None, r"the last batch held \[4, 5\]"),
    ]:
        (result,) = shared.run([SharedRequest(3, method, argument)])
        with pytest.raises(PolicyStateError, match=says):
            raise result


# -- resets ------------------------------------------------------------------------------------------------------------


def test_a_reset_that_failed_is_tried_again_for_the_same_environments() -> None:
    """The next client of this place must not meet what is left; until then nothing is answered."""

    class Stubborn(Wayward):
        calls: list[list[int]]

        def reset_envs(self, env_idx_list: Sequence[int]) -> None:
            self.calls.append(list(env_idx_list))
            if len(self.calls) == 1:
                raise RuntimeError("not now")

    stubborn = Stubborn()
    stubborn.calls = []
    shared = SharedModel(stubborn)
    shared.run([SharedRequest(2, "update_obs", observed(0, 4))])
    (result,) = shared.run([SharedRequest(2, "reset")])
    assert isinstance(result, RuntimeError)
    for argument in ([4], None):
        (result,) = shared.run([SharedRequest(2, "get_action_batch", argument)])
        assert isinstance(result, PolicyStateError)
    for _ in range(2):
        assert shared.run([SharedRequest(2, "reset")]) == [None]
    assert stubborn.calls == [[2 * SPAN + 4], [2 * SPAN + 4], []]
