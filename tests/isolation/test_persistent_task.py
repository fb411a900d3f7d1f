"""A persistent task loads the model once and answers several requests."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import pytest

from xpl_cli.isolation import subprocess_task

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MODEL = """
import os
from xpl import Policy

class Model(Policy):
    def load(self, config):
        if config.get("broken"):
            raise ValueError("no weights")
        self.count = 0
        input_was = os.read(0, 8)  # an adapter that reads the standard input gets nothing
        assert input_was == b"", input_was

    def predict(self, inputs, envs):
        self.count += 1
        if self.config.get("dies") == self.count:
            os._exit(7)
        import numpy as np
        return np.full((len(envs), 1, 8), float(self.count))
"""
BLOCK = {
    "action": {
        "parts": [{"joints": {"arm": "single"}}, {"gripper": {"arm": "single", "closed": 0.0, "open": 100.0}}],
        "reference": "absolute",
    }
}


@pytest.fixture
def loaded(tmp_path: Path) -> Iterator[Any]:
    """Return a function that loads the adapter in a process of its own."""
    (tmp_path / "model.py").write_text(MODEL)
    opened = []

    def load(**config: Any) -> subprocess_task.PersistentTask:
        manifest = {"model_class": "Model", "model_io": BLOCK, "temporal": {"kind": "chunk", "chunk": 1}}
        told = {"env_cfg_type": "franka_single", "action_type": "joint", **config}
        order = {"policy_dir": str(tmp_path), "config": told, "manifest": manifest, "block": BLOCK}
        opened.append(
            subprocess_task.PersistentTask(
                "xpl.worker.perturbed_answers", order, subprocess_task.TaskSettings(sys.executable, tmp_path)
            )
        )
        return opened[-1]

    yield load
    for one in opened:
        one.close()


def _order(**more: Any) -> dict[str, Any]:
    observation = {"env_idx": 0, "state": {"arm_joint_state": [0.0] * 7, "ee_joint_state": [0.5]}}
    calls = [{"reset": True}, {"show": [[0, "first"]]}, {"ask": [0]}]
    return {"blocks": [BLOCK], "observations": {"first": observation}, "calls": calls, "seconds": 60.0, **more}


def test_the_model_and_its_observations_stay(loaded: Any) -> None:
    task = loaded()
    assert [one.result for one in task.loaded.answers] == [None]
    for _ in range(2):
        first, answer = task.request(_order(), 60.0).answers
        assert (first.result, first.error) == (None, None)
        # The block reads nothing, so that the model's first answer is remembered.
        assert answer.result[0][0]["ee_joint_state"][0] == pytest.approx(0.01)
    (_, again) = task.request(_order(observations={}), 60.0).answers
    assert again.error is None


def test_what_cannot_be_loaded_says_so(loaded: Any) -> None:
    (answer,) = loaded(broken=True).loaded.answers
    assert "ValueError: no weights" in str(answer.error)


def test_a_process_that_ends_gives_no_more_answers(loaded: Any) -> None:
    task = loaded(dies=1)
    done = task.request(_order(), 60.0)
    assert [one.result for one in done.answers] == [None], "the adapter answered once, then its process ended"
    assert task.request(_order(), 60.0).answers == []
