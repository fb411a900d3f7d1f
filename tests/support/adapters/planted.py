"""A small network behind a model_io block, or behind code, in which mistakes are planted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tests.support.adapters.model_io import Case, fields, observation
from xpl import rotation
from xpl.convert import compile_interface
from xpl.policy import Policy
from xpl_cli.model_io.difference import EpisodeAnswers

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

STEPS, HIDDEN = 4, 48
EPISODES = ((0, 0), (1, 0, 0))
"""Of each episode the environments that are shown and asked about."""
TEXTS = ("  Pick the Red cup. ", "fold IT.", "open both drawers ", "Stack the blocks")
_WEIGHTS: dict[Any, np.ndarray] = {}


class FixedNetwork:
    """A fixed function that every number, pixel and letter has a part in.

    Args:
        bias: (H, D), what it answers near to.
    """

    def __init__(self, bias: np.ndarray) -> None:
        self._bias = bias
        self._reach = 0.15 * np.maximum(np.abs(bias).mean(0), 1e-3)

    def __call__(self, inputs: Mapping[str, Any]) -> np.ndarray:
        """Return an answer (H, D) to the inputs of one environment."""
        total = sum(self._seen(name, value) for name, value in sorted(inputs.items()))
        out = self._weights("out", HIDDEN, self._bias.size)
        rows = (np.tanh(total) @ out).reshape(self._bias.shape)
        return np.asarray(self._bias + self._reach * np.tanh(rows))

    def _seen(self, name: str, value: Any) -> np.ndarray:
        if isinstance(value, str):
            value = np.frombuffer(value.encode().ljust(96, b"\0")[:96], np.uint8)
        array = np.asarray(value)
        flat = array.astype(np.float64).ravel() / (128.0 if array.dtype == np.uint8 else 1.0)
        return np.asarray(flat @ self._weights(name, flat.size, HIDDEN))

    @staticmethod
    def _weights(name: str, rows: int, columns: int) -> np.ndarray:
        key = (name, rows, columns)
        if key not in _WEIGHTS:
            rng = np.random.default_rng([sum(map(ord, name)), rows, columns])
            _WEIGHTS[key] = rng.normal(size=(rows, columns)) / np.sqrt(rows)
        return _WEIGHTS[key]


class BlockPolicy(Policy):
    """A policy whose conversions are those of its block."""

    def load(self, config: Mapping[str, Any]) -> None:
        """Take the network that it is given."""
        self.network = config["network"]

    def predict(self, inputs: Any, envs: list[int]) -> Any:
        """Answer each environment by itself."""
        return [self.network({name: values[row] for name, values in inputs.items()}) for row in range(len(envs))]


class RecordedEpisodes:
    """Episodes of a case, and what a block makes of them.

    Args:
        case: robot, action type, and the right block.
    """

    def __init__(self, case: Case) -> None:
        self.case = case
        rng = np.random.default_rng(5)
        state, near = (fields(case.robot, rng, joints=True) for _ in range(2))
        interface = compile_interface(case.model_io, case.embodiment, case.action_type)
        self.network = FixedNetwork(interface.action.encode([self._moved(near, rng) for _ in range(STEPS)], state, {}))
        self.episodes = [
            [
                (env, observation(case.robot, 10 * number + step, instruction=TEXTS[(number + step) % len(TEXTS)]))
                for step, env in enumerate(envs)
            ]
            for number, envs in enumerate(EPISODES)
        ]

    def answers(self, model_io: Mapping[str, Any]) -> list[Any]:
        """Return the answers of the network behind a block, question by question."""
        case = self.case
        model = BlockPolicy(
            {
                "env_cfg_type": case.robot,
                "action_type": case.action_type,
                "network": self.network,
                "manifest": {"model_io": model_io, "temporal": {"chunk": STEPS}},
            }
        )
        return self.asked(model)

    def asked(self, model: Policy) -> list[Any]:
        """Return what a policy answers to every observation of the episodes."""
        actions = []
        for episode in self.episodes:
            for env, obs in episode:
                model.update_obs({**obs, "env_idx": env})
                actions += model.get_action_batch([env])
            model.reset()
        return actions

    def threads(self, model_io: Sequence[Any], expected: Sequence[Any]) -> list[EpisodeAnswers]:
        """Return the episodes of each environment with both answers."""
        parts: dict[tuple[int, int], list[tuple[Any, Any, Any]]] = {}
        observed = [(number, env, obs) for number, episode in enumerate(self.episodes) for env, obs in episode]
        for (number, env, obs), one, other in zip(observed, model_io, expected, strict=True):
            parts.setdefault((number, env), []).append((obs, one, other))
        return [
            EpisodeAnswers(
                [obs for obs, _, _ in part], range(len(part)), [one for _, one, _ in part], [two for *_, two in part]
            )
            for part in parts.values()
        ]

    def _moved(self, near: Mapping[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
        keys = self.case.embodiment.dims(self.case.action_type)
        return {key: _moved(key, near[key], rng) for key in keys}


def _moved(key: str, value: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if key.endswith("ee_joint_state"):
        return rng.uniform(0.2, 0.8, value.shape)
    if key.endswith("ee_pose"):
        turn = rotation.normalise(value[3:] + 0.2 * rng.normal(size=4))
        return np.concatenate((value[:3] + 0.05 * rng.normal(size=3), turn))
    return value + 0.3 * rng.normal(size=value.shape)
