"""An adapter with a model_io block writes load and predict: batches, histories, resets and questions put twice."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.adapters.model_io import observation
from xpl.convert import ConversionError
from xpl.policy import Policy

if TYPE_CHECKING:
    from collections.abc import Mapping

STEP = 0.1


class ModelIO(Policy):
    def load(self, config: Mapping[str, Any]) -> None:
        self.given: list[dict[str, Any]] = []
        self.fails = False

    def predict(self, inputs: Any, envs: list[int]) -> np.ndarray:
        if self.fails:
            raise RuntimeError("out of memory")
        self.given.append(inputs)
        return np.full((len(envs), 2, 8), STEP)


def _policy(cls: type[Policy] = ModelIO, *, reference: str = "delta_command", chunk: int = 2, **model_io: Any) -> Any:
    action = {
        "reference": reference,
        "parts": [{"joints": {"arm": "single"}}, {"gripper": {"arm": "single", "closed": 0.0, "open": 1.0}}],
    }
    state = [{"input": "q", "parts": [{"joints": {"arm": "single"}}]}]
    manifest = {"temporal": {"chunk": chunk}, "model_io": {"state": state, "action": action, **model_io}}
    return cls({"env_cfg_type": "franka_single", "action_type": "joint", "manifest": manifest})


def _obs(env: int = 0, number: float = 0.0) -> dict[str, Any]:
    obs = {**observation("franka_single", env), "env_idx": env}
    obs["state"]["arm_joint_state"] = np.full(7, number)
    return obs


def _first(chunk: list[dict[str, np.ndarray]]) -> list[float]:
    return [round(float(step["arm_joint_state"][0]), 4) for step in chunk]


def test_inputs_arrive_batched_under_the_models_names() -> None:
    policy = _policy(instruction={"input": "prompt"})
    policy.update_obs_batch([_obs(0, 0.1), _obs(1, 0.2), _obs(2, 0.3)])
    policy.get_action_batch([2, 0])
    (given,) = policy.given
    assert given["q"].dtype == np.float32
    assert given["q"][:, 0].tolist() == pytest.approx([0.3, 0.1])
    assert given["prompt"] == ["Fold it.", "Fold it."]


def test_a_history_is_kept_for_each_environment() -> None:
    """As long as the block needs it, whatever the manifest's own history is."""
    policy = _policy(history={"length": 2, "stride": 2})
    for number in range(5):
        policy.update_obs_batch([_obs(0, number), _obs(1, 10 + number)])
    policy.get_action_batch([0, 1])
    assert policy.given[0]["q"][:, :, 0].tolist() == [[2, 4], [12, 14]]
    policy.reset_envs([0])
    policy.update_obs_batch([_obs(0, 7), _obs(1, 15)])
    policy.get_action_batch([0, 1])
    assert policy.given[1]["q"][:, :, 0].tolist() == [[7, 7], [13, 15]]


def test_commands_go_on_over_chunks_and_not_over_episodes() -> None:
    policy = _policy()
    policy.update_obs(_obs(0, 1.0))
    assert _first(policy.get_action()) == [1.1, 1.2]
    policy.update_obs(_obs(0, 5.0))
    assert _first(policy.get_action()) == [1.3, 1.4]
    policy.update_obs(_obs(1, 2.0))
    assert _first(policy.get_action()) == [2.1, 2.2]
    policy.reset()
    policy.update_obs(_obs(0, 5.0))
    assert _first(policy.get_action()) == [5.1, 5.2]


def test_a_question_put_twice_has_one_answer() -> None:
    policy = _policy()
    for wanted in ([1.1, 1.2], [1.3, 1.4]):
        policy.update_obs(_obs(0, 1.0))
        assert [_first(policy.get_action()) for _ in range(3)] == [wanted] * 3


def test_a_question_that_fails_changes_nothing() -> None:
    policy = _policy()
    policy.update_obs(_obs(0, 1.0))
    policy.get_action()
    policy.update_obs(_obs(0, 1.0))
    policy.fails = True
    with pytest.raises(RuntimeError, match="out of memory"):
        policy.get_action()
    policy.fails = False
    assert _first(policy.get_action()) == [1.3, 1.4]


def test_observations_that_nobody_asked_about_do_not_move_the_command() -> None:
    policy = _policy()
    for shown in (1, 3):
        for _ in range(shown):
            policy.update_obs(_obs(0, 1.0))
        found = _first(policy.get_action())
    assert found == [1.3, 1.4]


def test_the_state_at_the_call_is_the_newest_observation() -> None:
    policy = _policy(reference="delta_state", history={"length": 3})
    for number in (1.0, 2.0, 3.0):
        policy.update_obs(_obs(0, number))
    assert _first(policy.get_action()) == [3.1, 3.1]


def test_signs_are_those_of_the_environment_and_the_episode() -> None:
    """Arms that turn beyond a half turn do not disturb each other; a reset begins anew, and asking does not count."""
    part = {"rotation": {"arm": "single", "form": "quaternion_wxyz", "sign": "continuous"}}
    policy = _policy(state=[{"input": "q", "parts": [part]}])

    def ask(env: int, angle: float) -> float:
        obs = _obs(env)
        obs["state"]["ee_pose"] = np.array([0, 0, 0, np.cos(angle / 2), np.sin(angle / 2), 0, 0])
        policy.update_obs(obs)
        policy.get_action_batch([env])
        policy.get_action_batch([env])
        return round(float(policy.given[-1]["q"][0, 0]), 3)

    assert [ask(0, angle) for angle in (0, 2, 4, 6)] == [1, 0.54, -0.416, -0.99]
    assert ask(1, 6) == 0.99
    assert ask(0, 6) == -0.99
    policy.reset_envs([0])
    assert ask(0, 6) == 0.99


def test_an_encode_of_ones_own_is_given_as_ever() -> None:
    """Lists of the manifest's history, even where the block keeps more observations."""

    class Own(ModelIO):
        def encode(self, obs: Mapping[str, Any], env: int) -> float:
            return float(obs["state"]["arm_joint_state"][0])

    policy = _policy(Own, history={"length": 3})
    for number in range(3):
        policy.update_obs(_obs(0, number))
    policy.get_action()
    assert policy.given == [[2.0]]


def test_a_block_that_does_not_fit_stops_the_start() -> None:
    gripper = {"gripper": {"arm": "single", "closed": 0, "open": 1}}
    action = {"reference": "absolute", "steps": 5, "parts": [{"joints": {"arm": "single"}}, gripper]}
    manifest = {"temporal": {"chunk": 2}, "model_io": {"action": action}}
    with pytest.raises(ConversionError, match=r"model_io.action.steps is 5, and temporal.chunk 2"):
        ModelIO({"env_cfg_type": "franka_single", "manifest": manifest})
