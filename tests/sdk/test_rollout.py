"""The environment side's loop: the order of calls, the horizon, batches, and what it does not accept."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xpl.action import ActionError
from xpl.rollout import run_batch, run_episode
from xpl_cli.basics.content import content_folder, load_module

ADAPTER_LOOP = load_module(content_folder("policy") / "demo_policy" / "deploy.py")


class Counting:
    guarded = True

    def __init__(self, lengths: list[int], log: list[Any]) -> None:
        self._lengths, self._log = lengths, log
        self._steps = [0] * len(lengths)

    def get_obs(self) -> dict[str, Any]:
        return self.get_obs_batch([0])[0]

    def get_obs_batch(self, env_idx_list: list[int]) -> list[dict[str, Any]]:
        return [{"env_idx": env, "step": self._steps[env]} for env in env_idx_list]

    def take_action(self, action: Any) -> None:
        self.take_action_batch([action], [0])

    def take_action_batch(self, actions: list[Any], env_idx_list: list[int]) -> None:
        self._log.append(("act", list(env_idx_list), list(actions)))
        for env in env_idx_list:
            self._steps[env] += 1

    def is_episode_end(self) -> bool:
        return not self.get_running_env_idx_list()

    def get_running_env_idx_list(self) -> list[int]:
        return [env for env, length in enumerate(self._lengths) if self._steps[env] < length]

    def results(self) -> list[dict[str, Any]]:
        return [{"env_idx": env, "steps": steps} for env, steps in enumerate(self._steps)]


class Scripted:
    def __init__(self, chunk: int, log: list[Any]) -> None:
        self._chunk, self._log = chunk, log
        self.questions = 0

    def call(self, func_name: str, obs: Any = None) -> Any:
        self._log.append((func_name, obs))
        if not func_name.startswith("get_action"):
            return None
        self.questions += 1
        chunks = [[(self.questions, env, step) for step in range(self._chunk)] for env in obs or [0]]
        return chunks if func_name == "get_action_batch" else chunks[0]


@given(st.lists(st.integers(0, 7), min_size=1, max_size=4), st.integers(1, 4))
def test_with_whole_chunks_our_loops_are_the_adapters(lengths: list[int], chunk: int) -> None:
    """deploy.py of the scaffold and ours show, ask and execute the same in the same order."""
    for counts, ours, theirs in (
        (lengths, run_batch, ADAPTER_LOOP.eval_one_episode_batch),
        ([lengths[0] + 1], run_episode, ADAPTER_LOOP.eval_one_episode),
    ):
        logs: list[list[Any]] = [[], []]
        for log, loop in zip(logs, (ours, theirs), strict=True):
            loop(Counting(counts, log), Scripted(chunk, log))
        assert logs[0] == logs[1]


@pytest.mark.parametrize(
    ("horizon", "asked"), [(None, [1, 1, 1, 2, 2, 2, 3]), (1, [1, 2, 3, 4, 5, 6, 7]), (2, [1, 1, 2, 2, 3, 3, 4])]
)
@pytest.mark.parametrize("run", [run_episode, run_batch])
def test_the_horizon_says_how_much_of_a_chunk_is_executed(run: Any, horizon: int | None, asked: list[int]) -> None:
    for given_horizon in {horizon, horizon or 99}:
        log: list[Any] = []
        run(Counting([7], log), Scripted(3, log), horizon=given_horizon)
        assert [actions[0][0] for name, *rest in log if name == "act" for actions in rest[1:]] == asked
        kinds = ["act" if name == "act" else "see" for name, *_ in log if name == "act" or name.startswith("update")]
        assert kinds == ["see", "act"] * 7


def test_observations_without_an_index_get_theirs() -> None:
    """A list that has shrunk says no longer by position whose observation is whose."""

    class Nameless(Counting):
        def get_obs_batch(self, env_idx_list: list[int]) -> list[dict[str, Any]]:
            return [{"step": self._steps[env]} for env in env_idx_list]

    log: list[Any] = []
    run_batch(Nameless([1, 3], log), Scripted(1, log))
    seen = [
        [each["env_idx"] for each in obs] for name, obs in (entry[:2] for entry in log) if name == "update_obs_batch"
    ]
    assert seen == [[0, 1], [1], [1]]


class Odd(Scripted):
    def __init__(self, answer: Any) -> None:
        super().__init__(1, [])
        self._answer = answer

    def call(self, func_name: str, obs: Any = None) -> Any:
        return self._answer if func_name.startswith("get_action") else None


@pytest.mark.parametrize("chunk", [[], None, "text", np.zeros((4, 7)), {"arm_joint_state": []}])
def test_a_chunk_that_holds_no_actions_is_an_error(chunk: Any) -> None:
    with pytest.raises(ActionError, match="at least one action step"):
        run_episode(Counting([3], []), Odd(chunk))
    with pytest.raises(ActionError, match="at least one action step"):
        run_batch(Counting([3, 3], []), Odd([[(1,)], chunk]))


@pytest.mark.parametrize("answer", [None, [], [[1]], [[1], [1], [1]]])
def test_a_batch_needs_one_chunk_for_each_environment(answer: Any) -> None:
    with pytest.raises(ActionError, match=r"environments \[0, 1\]"):
        run_batch(Counting([3, 3], []), Odd(answer))


def test_chunks_of_several_lengths_are_executed_as_far_as_the_shortest_goes() -> None:
    log: list[Any] = []

    class Uneven(Scripted):
        def call(self, func_name: str, obs: Any = None) -> Any:
            answer = super().call(func_name, obs)
            return [answer[0][:1], *answer[1:]] if func_name == "get_action_batch" and len(obs) > 1 else answer

    policy = Uneven(3, log)
    run_batch(Counting([2, 5], log), policy)
    assert [actions[-1] for name, *rest in log if name == "act" for actions in rest[1:]] == [
        (1, 1, 0), (2, 1, 0), (3, 1, 0), (3, 1, 1), (3, 1, 2),
    ]  # fmt: skip


def test_a_horizon_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        run_episode(Counting([3], []), Scripted(1, []), horizon=0)
