"""Memory of recurrent policies: it advances once for each observation that is asked about, whatever else happens."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from tests.support.examples import examples
from xpl import _spec as spec
from xpl.memory import MemoryUseError
from xpl.policy import Policy, PolicyStateError

CONFIG: dict[str, Any] = {"env_cfg_type": "franka_single", "action_type": "joint"}
CLIENT = spec.LIMITS["client_envs"]
ENVS = (0, 1, 2, CLIENT, CLIENT + 1)
"""Environments of two clients that share the model."""


def advance(state: float, number: float) -> float:
    """Return a memory that tells which observations were asked about, and in which order."""
    return (state * 31 + number) % 1009


class UnhappyError(Exception):
    """What a model raises."""


class Recurrent(Policy):
    def load(self, config: Any) -> None:
        self.spoiled: set[int] = set()

    def encode(self, obs: Any, env: int) -> int:
        return int(obs["number"])

    def predict(self, inputs: list[int], envs: list[int]) -> list[np.ndarray]:
        rows = []
        for number, env in zip(inputs, envs, strict=True):
            memory = self.memory(env)
            before = np.zeros(1) if memory.value is None else memory.value["state"]
            after = np.array([advance(float(before[0]), number)])
            memory.keep({"state": after})
            rows.append(np.array([[before[0], after[0], memory.skipped, 0, 0, 0, 0, 0]]))
            after[0] = -1.0  # a buffer that the model uses again
        if self.spoiled & set(inputs):
            raise UnhappyError
        return rows


@dataclass
class Reference:
    """The automaton that a memory has to be: of one environment in one episode.

    Attributes:
        shown: observations so far.
        asked: which of them the last answer was about, -1 for none.
        states: memory before that one, and after it.
        skipped: observations between that one and the one before.
    """

    shown: list[int] = field(default_factory=list)
    asked: int = -1
    states: tuple[float, float] = (0.0, 0.0)
    skipped: int = 0

    def answer(self) -> list[float]:
        newest = len(self.shown) - 1
        if newest != self.asked:
            self.skipped = newest - self.asked - 1
            self.states = (self.states[1], advance(self.states[1], self.shown[-1]))
            self.asked = newest
        return [*self.states, self.skipped]


class Machine(RuleBasedStateMachine):
    """A policy with memory against the automaton: observations, questions, failures and resets in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.policy = Recurrent(CONFIG)
        self.references: dict[int, Reference] = {}
        self.count = 0

    @rule(envs=st.lists(st.sampled_from(ENVS), unique=True, min_size=1))
    def show(self, envs: list[int]) -> None:
        batch = []
        for env in envs:
            self.count = (self.count + 1) % 97
            self.references.setdefault(env, Reference()).shown.append(self.count)
            batch.append({"number": self.count, "env_idx": env})
        self.policy.update_obs_batch(batch)

    @precondition(lambda self: self.references)
    @rule(data=st.data())
    def ask(self, data: st.DataObject) -> None:
        envs = data.draw(st.lists(st.sampled_from(sorted(self.references)), unique=True, min_size=1))
        expected = [self.references[env].answer() for env in envs]
        got = [
            [float(value) for value in chunk[0]["arm_joint_state"][:3]] for chunk in self.policy.get_action_batch(envs)
        ]
        assert got == expected

    @precondition(lambda self: self.references)
    @rule(data=st.data())
    def fail(self, data: st.DataObject) -> None:
        envs = data.draw(st.lists(st.sampled_from(sorted(self.references)), unique=True, min_size=1))
        self.policy.spoiled = {self.references[envs[0]].shown[-1]}
        with pytest.raises(UnhappyError):
            self.policy.get_action_batch(envs)
        self.policy.spoiled = set()

    @rule(client=st.sampled_from([0, CLIENT]))
    def reset_one_client(self, client: int) -> None:
        envs = [env for env in ENVS if env // CLIENT == client // CLIENT]
        self.policy.reset_envs(envs)
        for env in envs:
            self.references.pop(env, None)

    @rule()
    def reset(self) -> None:
        self.policy.reset()
        self.references.clear()


TestMemory = Machine.TestCase
TestMemory.settings = settings(max_examples=examples(60), stateful_step_count=25, deadline=None)


def test_a_memory_is_for_questions_alone() -> None:
    """Neither `encode`, which may run late or never, nor anything outside a question reads or keeps."""
    policy = Recurrent(CONFIG)
    with pytest.raises(PolicyStateError, match="has no observation"):
        policy.memory(0)
    policy.update_obs({"number": 1})
    for use in (lambda: policy.memory(0).value, lambda: policy.memory(0).skipped, lambda: policy.memory(0).keep(1)):
        with pytest.raises(MemoryUseError, match="is for predict and decode"):
            use()


def test_what_is_kept_cannot_be_changed_afterwards() -> None:
    class Careless(Recurrent):
        def predict(self, inputs: list[int], envs: list[int]) -> list[np.ndarray]:
            memory = self.memory(envs[0])
            if memory.value is not None:
                memory.value["deep"][0] += 1
            memory.keep({"deep": np.zeros(1), "text": "kept", "pair": (np.zeros(1), [np.ones(1)])})
            return [np.zeros((1, 8))]

    policy = Careless(CONFIG)
    policy.update_obs({"number": 1})
    policy.get_action()
    policy.update_obs({"number": 2})
    with pytest.raises(ValueError, match="read-only"):
        policy.get_action()


def test_an_answer_without_anything_kept_leaves_it_as_it_was() -> None:
    class Seldom(Recurrent):
        def predict(self, inputs: list[int], envs: list[int]) -> list[np.ndarray]:
            memory = self.memory(envs[0])
            seen = 0 if memory.value is None else memory.value
            if inputs[0] % 2:
                memory.keep(inputs[0])
            return [np.full((1, 8), float(seen)) * np.array([1, 0, 0, 0, 0, 0, 0, 0])]

    policy, seen = Seldom(CONFIG), []
    for number in range(1, 6):
        policy.update_obs({"number": number})
        seen.append(float(policy.get_action()[0]["arm_joint_state"][0]))
    assert seen == [0, 1, 1, 3, 3]
