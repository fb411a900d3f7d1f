"""What an adapter draws is drawn from its environments' own generators instead."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.adapters.model_io import observation
from xpl.policy import Policy
from xpl.wire import packed
from xpl.worker.encoded import play

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

CONFIG = {"env_cfg_type": "franka_single", "action_type": "joint"}
CALLS = [
    {"show": [[env, {**observation("franka_single", env), "env_idx": env}] for env in (0, 3)]},
    {"ask": [3, 0]},
    {"reset": True},
    {"show": [[0, {**observation("franka_single", 2), "env_idx": 0}]]},
    {"ask": [0]},
]


class Drawing(Policy):
    draw: Callable[[Policy, int, list[int]], Any]

    def encode(self, obs: Mapping[str, Any], env: int) -> Any:
        return obs["state"]["arm_joint_state"]

    def predict(self, inputs: list[Any], envs: list[int]) -> Any:
        return [np.asarray(type(self).draw(self, number, envs)) * 0.1 for number in range(len(envs))]


def _answers(draw: Callable[[Policy, int, list[int]], Any], how: str) -> dict[str, Any]:
    adapter = type("Adapter", (Drawing,), {"draw": staticmethod(draw), "__module__": __name__})
    (answer,) = play.changes(adapter(CONFIG), [{"kind": "drawn", "as": how}], CALLS, 100.0)
    told: dict[str, Any] = packed.decode(answer)
    assert "error" not in told, told
    return dict(told["result"])


def _joints(found: Mapping[str, Any]) -> list[Any]:
    return [chunk[0]["arm_joint_state"] for chunk in found["answers"]]


def _right(model: Policy, number: int, envs: list[int]) -> Any:
    return model.rng(envs[number]).standard_normal((1, 8))


RIGHT = _joints(_answers(_right, "own"))


@pytest.mark.parametrize(
    "draw",
    [
        lambda _model, _number, _envs: np.random.default_rng(7).standard_normal((1, 8)),
        lambda _model, _number, _envs: np.random.standard_normal((1, 8)),  # noqa: NPY002
        lambda _model, _number, _envs: np.random.randn(1, 8),  # noqa: NPY002
        lambda _model, _number, _envs: np.random.normal(0.0, 1.0, (1, 8)),  # noqa: NPY002
        lambda model, _number, envs: model.rng(envs[0]).standard_normal(size=(1, 8)),
    ],
    ids=["constant", "global", "older", "scaled", "first"],
)
def test_each_draws_from_its_own(draw: Callable[[Policy, int, list[int]], Any]) -> None:
    kept = np.random.standard_normal, np.random.default_rng
    found = _answers(draw, "own")
    assert found["draws"] == 3
    assert all(np.array_equal(one, other) for one, other in zip(_joints(found), RIGHT, strict=True))
    assert (np.random.standard_normal, np.random.default_rng) == kept


def test_all_at_once() -> None:
    drawn: list[Any] = []

    def draw(model: Policy, number: int, envs: list[int]) -> Any:
        if number == 0:
            drawn[:] = model.rng(envs[0]).standard_normal((len(envs), 1, 8))
        return drawn[number]

    assert np.array_equal(_joints(_answers(draw, "own")), RIGHT)


def test_another_precision() -> None:
    def draw(model: Policy, number: int, envs: list[int]) -> Any:
        return model.rng(envs[number]).standard_normal((1, 8), dtype=np.float32)

    assert np.array_equal(_joints(_answers(draw, "double")), RIGHT)
    assert not np.array_equal(_joints(_answers(draw, "own")), RIGHT)


def test_generators_of_others_are_theirs() -> None:
    def draw(_model: Policy, _number: int, _envs: list[int]) -> Any:
        return eval("numpy.random.default_rng(3).random((1, 8))", {"numpy": np, "__name__": "network"})  # noqa: S307

    found = _joints(_answers(draw, "own"))
    assert found[0] == pytest.approx(np.random.default_rng(3).random((1, 8))[0, :7] * 0.1)


def test_nothing_is_drawn() -> None:
    assert _answers(lambda _model, _number, _envs: np.zeros((1, 8)), "own")["draws"] == 0
