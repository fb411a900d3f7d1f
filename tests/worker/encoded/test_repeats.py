"""Calls that advance a state twice by one observation are found, and those that do not are made."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from xpl.worker.encoded.repeats import StepOncePerObservation


class Cell:
    """A recurrent cell: its state is what it is given, or its own."""

    def __init__(self) -> None:
        self.calls = 0
        self.state = np.zeros(2)

    def step(self, hidden: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return an answer and the next state."""
        self.calls += 1
        after = np.tanh(hidden + seen)
        return after.sum(), after

    def advance(self, seen: np.ndarray) -> np.ndarray:
        """Advance its own state."""
        self.calls += 1
        self.state = np.tanh(self.state + seen)
        return self.state


class Model:
    """Holds a cell."""

    def __init__(self) -> None:
        self.cell = Cell()


def test_a_step_from_the_state_that_the_step_before_led_to_is_left_out() -> None:
    model, once = Model(), StepOncePerObservation()
    seen, hidden = np.ones(2), np.zeros(2)
    with once.around(model):
        first, hidden = model.cell.step(hidden, seen)
        again, hidden = model.cell.step(hidden, seen)
        other, _ = model.cell.step(hidden, 2 * seen)
    assert (first, once.left_out, model.cell.calls) == (again, 1, 2)
    assert other != first
    assert "step" not in vars(model.cell), "the methods are as they were"


def test_a_state_that_the_model_keeps_to_itself_is_advanced_once() -> None:
    model, once = Model(), StepOncePerObservation()
    with once.around(model):
        for seen in (np.ones(2), np.ones(2), np.full(2, 0.5)):
            model.cell.advance(seen)
    assert once.left_out == 1
    assert np.allclose(model.cell.state, np.tanh(np.tanh(np.ones(2)) + 0.5))


@pytest.mark.parametrize("hidden", [np.full(2, 7.0), np.zeros(3)])
def test_another_state_is_another_call(hidden: Any) -> None:
    """Of a second environment that shows the same."""
    model, once = Model(), StepOncePerObservation()
    with once.around(model):
        model.cell.step(np.zeros(2), np.ones(2))
        model.cell.step(hidden, np.ones(len(hidden)))
    assert once.left_out == 0
