"""The fit of the state that a reference read, on a network of two layers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from xpl.catalogue import AdapterCase
from xpl.conventions.gripper import CONVENTION as GRIPPER
from xpl.embodiment import get_embodiment
from xpl_cli.audit.offline.parity.judgement import Judgement
from xpl_cli.audit.offline.parity.state_fit import StateFit
from xpl_cli.audit.offline.search.loaded_adapter import MistakeAnswers
from xpl_cli.audit.offline.search.session_replay import SessionReplay
from xpl_cli.model_io import script
from xpl_cli.model_io.pairs import PairSession

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from xpl.catalogue import Mistake
    from xpl_cli.model_io.pairs import Chunk

PARTS = [{"joints": {"arm": "single"}}, {"gripper": {"arm": "single", "closed": 0, "open": 4.5}}]
BLOCK = {
    "state": [{"input": "qpos", "parts": PARTS}],
    "action": {"reference": "absolute", "parts": PARTS},
}
CALLS = script.short_script()
WIDTH = 8


def network(state: np.ndarray, *, image: float = 0.0) -> Chunk:
    """Return the actions of a network for an encoded state, and for something that is not of the state."""
    rng = np.random.default_rng(1)
    hidden = np.tanh(rng.normal(size=(32, WIDTH)) @ state * 0.2 + image * rng.normal(size=32))
    numbers = np.tanh(rng.normal(size=(5, WIDTH, 32)) @ hidden * 0.2)
    return [
        {"arm_joint_state": row[:7].astype(np.float32), "ee_joint_state": row[7:].astype(np.float32)} for row in numbers
    ]


def session_of(chunks: Sequence[Chunk]) -> PairSession:
    """Return a session with these golden answers, in the order of its questions."""
    pending, answers = iter(chunks), []
    for call in CALLS:
        told = [next(pending) for _ in call.ask]
        stacked = [{key: np.stack([[step[key] for step in chunk]]) for key in chunk[0]} for chunk in told]
        answers += [tuple(stacked)] if told else []
    return PairSession("franka_single", "joint", 0, {"cam_head": (12, 16)}, 1, CALLS, tuple(answers))


def encoded(replay: SessionReplay, number: int) -> np.ndarray:
    """Return the state of a question as the adapter encodes it."""
    state = replay.observations_of(replay.session.questions[number])[-1]["state"]
    return np.concatenate([state["arm_joint_state"], 4.5 * state["ee_joint_state"]]).astype(np.float64)


class Loaded:
    """Answers under changes of the encoded state."""

    def __init__(self, replay: SessionReplay, answer: Callable[[np.ndarray], Chunk]) -> None:
        self._replay, self._answer, self.count = replay, answer, 0

    def answers_by_input_change(
        self, changes: Sequence[Mistake], questions: Sequence[int], _seconds: float
    ) -> list[MistakeAnswers]:
        """Return the answers to some questions under each change."""
        linear, found = GRIPPER.input_changes["linear"], []
        for one in changes:
            self.count += 1
            answers = {
                number: self._answer(linear({"qpos": encoded(self._replay, number)}, one.input_change or {})["qpos"])
                for number in questions
            }
            found.append(MistakeAnswers(one.description, one.convention, answers))
        return found


def fitted(golden: Callable[[np.ndarray], Chunk], answer: Callable[[np.ndarray], Chunk]) -> list[Mistake]:
    """Return what is found of an adapter whose answers are not the golden ones."""
    states = SessionReplay(session_of([network(np.zeros(WIDTH))] * 100))
    session = session_of([golden(encoded(states, number)) for number in states.all_questions])
    replay = SessionReplay(session)
    given = [answer(encoded(replay, number)) for number in replay.all_questions]
    judgement = Judgement(session, given, 1e-3, {})
    assert judgement.deviation is not None
    families: Any = SimpleNamespace(
        case=AdapterCase(get_embodiment("franka_single"), "joint", BLOCK),
        manifest=SimpleNamespace(temporal=SimpleNamespace(chunk=None)),
        seconds_left=60.0,
        loaded=Loaded(replay, answer),
    )
    return StateFit(families, replay, judgement, 30.0).mistakes()


@pytest.mark.parametrize(
    ("scale", "offset", "place", "convention"),
    [
        (0.4, 0.0, 7, "gripper"),
        (1.0, 0.7, 3, "joint_order"),
        (2.5, 0.1, 1, "normalization"),
        (57.29578, 0, 2, "angle_unit"),
    ],
)
def test_a_number_in_another_scale_is_fitted(scale: float, offset: float, place: int, convention: str) -> None:
    def read(state: np.ndarray) -> Chunk:
        moved = state.copy()
        moved[place] = scale * moved[place] + offset
        return network(moved / 10 if convention == "angle_unit" else moved)

    def plain(state: np.ndarray) -> Chunk:
        return network(state / 10 if convention == "angle_unit" else state)

    (found,) = fitted(read, plain)
    assert found.convention == convention
    assert f"qpos[{place}]" in found.description
    how = found.input_change or {}
    at = how["places"].index(place)
    assert how["scale"][at] == pytest.approx(scale, rel=0.02)


def test_what_is_not_of_the_state_is_not_fitted() -> None:
    assert fitted(network, lambda state: network(state, image=1.0)) == []
