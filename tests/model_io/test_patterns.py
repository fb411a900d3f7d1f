"""What is seen where no change explains a difference."""

from __future__ import annotations

from typing import Any

import numpy as np

from xpl_cli.model_io.difference import EpisodeAnswers, spreads
from xpl_cli.model_io.patterns import PolicyKind, patterns

RNG = np.random.default_rng(1)
GOLDEN = RNG.normal(size=(3, 2, 5, 2))
"""Of three episodes, two questions, five steps, two numbers."""


def _seen(answers: np.ndarray, kind: PolicyKind | None = None) -> list[str]:
    def chunks(rows: np.ndarray) -> list[list[dict[str, Any]]]:
        return [[{"arm_joint_state": values} for values in chunk] for chunk in rows]

    threads = [
        EpisodeAnswers([{}, {}], [0, 1], chunks(one), chunks(two)) for one, two in zip(GOLDEN, answers, strict=True)
    ]
    spread = spreads([chunk for thread in threads for chunk in thread.golden])
    return [one.convention for one in patterns(threads, spread, 1e-4, kind or PolicyKind())]


def _off(*where: Any) -> np.ndarray:
    answers = GOLDEN.copy()
    for index in where:
        answers[index] += 0.3
    return answers


def test_a_state_that_is_not_carried_on() -> None:
    """First answers are right, and later ones are not: what that means depends on the policy."""
    answers = _off(np.s_[:, 1])
    assert _seen(answers, PolicyKind(keeps_state=True)) == ["recurrent"]
    assert _seen(answers, PolicyKind(history=3)) == ["history_length"]
    assert _seen(answers) == ["action_reference"]
    assert _seen(_off(np.s_[1, 1]), PolicyKind(keeps_state=True)) == []


def test_what_is_remembered_outlives_a_reset() -> None:
    assert _seen(_off(np.s_[1:], np.s_[0, 1]), PolicyKind(keeps_state=True)) == ["recurrent"]
    assert _seen(_off(np.s_[1:, 0]), PolicyKind(history=3)) == ["history_length"]
    assert _seen(_off(np.s_[1:, 0])) == []
    assert _seen(_off(np.s_[1:], np.s_[0, 1])) == ["recurrent"]


def test_a_chunk_that_stands_still() -> None:
    assert _seen(np.repeat(GOLDEN[:, :, :1], 5, axis=2)) == ["chunk", "action_reference"]
    assert _seen(np.repeat(GOLDEN[:, :, 1:2], 5, axis=2)) == ["chunk"]


def test_later_steps_alone() -> None:
    assert _seen(_off(np.s_[:, :, 1:])) == ["action_reference"]


def test_other_draws_are_random_about_zero() -> None:
    answers = GOLDEN + RNG.normal(size=GOLDEN.shape) * 0.2
    assert _seen(answers, PolicyKind(draws=True)) == ["sampling"]
    assert _seen(answers) == []
    assert _seen(_off(np.s_[:]), PolicyKind(draws=True)) == []
