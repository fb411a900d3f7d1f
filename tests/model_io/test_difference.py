"""How far answers are from the golden ones, by number, as a share of the span of the golden answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from xpl_cli.model_io.difference import differences, spreads

POSE = np.array([0.1, 0.2, 0.3, 0.6, 0.8, 0.0, 0.0])


def _step(opening: float, pose: np.ndarray = POSE, **more: Any) -> dict[str, Any]:
    return {"ee_joint_state": np.array([opening]), "ee_pose": pose, **more}


GOLDEN = [[_step(0.0), _step(0.5, POSE + np.eye(7)[0])], [_step(0.25), _step(0.5)]]
SPREAD = spreads(GOLDEN)


def test_spans_are_those_of_a_keys_numbers() -> None:
    assert SPREAD["ee_joint_state[0]"] == 0.5
    assert SPREAD["ee_pose[1]"] == SPREAD["ee_pose[0]"] == 1.0
    assert SPREAD["ee_pose[5]"] == 1.0


def test_the_largest_difference_of_each_number_counts() -> None:
    answers = [[_step(0.0), _step(0.5, POSE + np.eye(7)[0])], [_step(0.5), _step(0.5, POSE - 0.25 * np.eye(7)[2])]]
    shares = differences(GOLDEN, answers, SPREAD)
    assert {part: value for part, value in shares.items() if value} == pytest.approx(
        {"ee_joint_state[0]": 0.5, "ee_pose[2]": 0.25}
    )


def test_both_signs_of_a_quaternion_are_one_rotation() -> None:
    turned = POSE * np.array([1, 1, 1, -1, -1, -1, -1])
    answers = [[_step(0.0, turned), GOLDEN[0][1]], GOLDEN[1]]
    assert max(differences(GOLDEN, answers, SPREAD).values()) == 0.0


def test_what_is_not_known_does_not_count() -> None:
    known_steps = [[None, GOLDEN[0][1]], [None, GOLDEN[1][1]]]
    assert max(differences(GOLDEN, known_steps, SPREAD).values()) == 0.0
    clipped = [[_step(np.nan), GOLDEN[0][1]], GOLDEN[1]]
    assert max(differences(GOLDEN, clipped, SPREAD).values()) == 0.0
    assert min(differences(GOLDEN, [[None, GOLDEN[0][1]], [None, None]], SPREAD).values()) == np.inf
    unknown = [[_step(np.nan), _step(np.nan)], [_step(np.nan), GOLDEN[1][1]]]
    assert differences(GOLDEN, unknown, SPREAD)["ee_joint_state[0]"] == np.inf


@pytest.mark.parametrize(
    "answers",
    [
        [GOLDEN[0]],
        [GOLDEN[0], GOLDEN[1][:1]],
        [GOLDEN[0], [GOLDEN[1][0], _step(np.inf)]],
        [[{"ee_pose": POSE}] * 2, [{"ee_pose": POSE}] * 2],
        [[_step(0.0) | {"ee_joint_state": np.zeros(2)}] * 2] * 2,
    ],
)
def test_what_cannot_be_compared_is_infinitely_far(answers: Any) -> None:
    assert differences(GOLDEN, answers, SPREAD)["ee_joint_state[0]"] == np.inf
