"""A watched model: what it does to observations, and resets that pass over a failure."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest

from xpl.worker.watch import CHANGED, SHARED, SWALLOWED, WatchedModel


class _Network:
    def __init__(self) -> None:
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1


class _Model:
    def __init__(self) -> None:
        self.network = _Network()
        self.obs: dict[str, Any] = {}

    def update_obs(self, obs: dict[str, Any]) -> None:
        self.obs = obs

    def get_action(self) -> list[dict[str, np.ndarray]]:
        return [{"pose": self.obs["state"]["pose"].copy()}]

    def reset(self) -> None:
        self.network.reset()


class _Careless(_Model):
    def get_action(self) -> list[dict[str, np.ndarray]]:
        self.obs["state"]["pose"] *= 2
        self.obs.pop("instruction", None)
        return [{"pose": self.obs["state"]["pose"][1:]}]

    def reset(self) -> None:
        with contextlib.suppress(RuntimeError):
            super().reset()


def _obs() -> dict[str, Any]:
    return {"instruction": "lift", "state": {"pose": np.arange(1.0, 4.0)}, "tags": ["a", "b"]}


def _watched(model: _Model) -> WatchedModel:
    watched = WatchedModel(model)
    watched.update_obs(_obs())
    watched.get_action()
    watched.get_action()
    return watched


def test_a_careful_model_leaves_no_note() -> None:
    watched = _watched(_Model())
    assert watched.watched_break_reset() == ["network.reset"]
    assert watched.watched_notes() == []


def test_changes_are_noted_by_operation_and_key() -> None:
    notes = [note for note in _watched(_Careless()).watched_notes() if note["what"] == CHANGED]
    assert [(note["method"], note["key"]) for note in notes] == [
        ("get_action", "instruction"),
        ("get_action", "state.pose"),
    ]


def test_a_change_to_an_earlier_observation_is_noted() -> None:
    class Late(_Model):
        def update_obs(self, obs: dict[str, Any]) -> None:
            if self.obs:
                self.obs["tags"][1] = "c"
            super().update_obs(obs)

    watched = WatchedModel(Late())
    watched.update_obs(_obs())
    watched.update_obs(_obs())
    assert [(note["method"], note["key"]) for note in watched.watched_notes()] == [("update_obs", "tags[1]")]


def test_shared_memory_is_noted_also_through_a_view() -> None:
    (note,) = [note for note in _watched(_Careless()).watched_notes() if note["what"] == SHARED]
    assert (note["key"], note["with"]) == ("[0].pose", "state.pose")


def test_a_swallowed_failure_of_a_reset_is_noted_and_undone() -> None:
    model = _Careless()
    watched = _watched(model)
    before = model.network.resets
    assert watched.watched_break_reset() == ["network.reset"]
    assert [note["key"] for note in watched.watched_notes() if note["what"] == SWALLOWED] == ["network.reset"]
    assert "reset" not in vars(model.network)
    assert model.network.resets == before + 1


def test_parts_that_reset_does_not_call_prove_nothing() -> None:
    class Forgetful(_Model):
        def reset(self) -> None:
            self.obs = {}

    watched = _watched(Forgetful())
    assert watched.watched_break_reset() == []
    assert watched.watched_notes() == []


def test_what_a_model_lacks_its_watched_form_lacks() -> None:
    with pytest.raises(AttributeError):
        WatchedModel(_Model()).get_action_batch  # noqa: B018
