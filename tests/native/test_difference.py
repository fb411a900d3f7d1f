"""How far answers are from the native ones, by number, as a share of the span of the native answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from xpl_cli.native.difference import differences, spreads

POSE = np.array([0.1, 0.2, 0.3, 0.6, 0.8, 0.0, 0.0])


def _step(opening: float, pose: np.ndarray = POSE, **more: Any) -> dict[str, Any]:
    return {"ee_joint_state": np.array([opening]), "ee_pose": pose, **more}


NATIVE = [[_step(0.0), _step(0.5, POSE + np.eye(7)[0])], [_step(0.25), _step(0.5)]]
SPREAD = spreads(NATIVE)


def test_spans_are_those_of_a_keys_numbers() -> None:
    assert SPREAD["ee_joint_state[0]"] == 0.5
    assert SPREAD["ee_pose[1]"] == SPREAD["ee_pose[0]"] == 1.0
    assert SPREAD["ee_pose[5]"] == 1.0


def test_the_largest_difference_of_each_number_counts() -> None:
    given = [[_step(0.0), _step(0.5, POSE + np.eye(7)[0])], [_step(0.5), _step(0.5, POSE - 0.25 * np.eye(7)[2])]]
    found = differences(NATIVE, given, SPREAD)
    assert {part: value for part, value in found.items() if value} == pytest.approx(
        {"ee_joint_state[0]": 0.5, "ee_pose[2]": 0.25}
    )


def test_both_signs_of_a_quaternion_are_one_rotation() -> None:
    turned = POSE * np.array([1, 1, 1, -1, -1, -1, -1])
    given = [[_step(0.0, turned), NATIVE[0][1]], NATIVE[1]]
    assert max(differences(NATIVE, given, SPREAD).values()) == 0.0


def test_what_is_not_known_does_not_count() -> None:
    known = [[None, NATIVE[0][1]], [None, NATIVE[1][1]]]
    assert max(differences(NATIVE, known, SPREAD).values()) == 0.0
    clipped = [[_step(np.nan), NATIVE[0][1]], NATIVE[1]]
    assert max(differences(NATIVE, clipped, SPREAD).values()) == 0.0
    assert min(differences(NATIVE, [[None, NATIVE[0][1]], [None, None]], SPREAD).values()) == np.inf
    unknown = [[_step(np.nan), _step(np.nan)], [_step(np.nan), NATIVE[1][1]]]
    assert differences(NATIVE, unknown, SPREAD)["ee_joint_state[0]"] == np.inf


@pytest.mark.parametrize(
    "given",
    [
        [NATIVE[0]],
        [NATIVE[0], NATIVE[1][:1]],
        [NATIVE[0], [NATIVE[1][0], _step(np.inf)]],
        [[{"ee_pose": POSE}] * 2, [{"ee_pose": POSE}] * 2],
        [[_step(0.0) | {"ee_joint_state": np.zeros(2)}] * 2] * 2,
    ],
)
def test_what_cannot_be_compared_is_infinitely_far(given: Any) -> None:
    assert differences(NATIVE, given, SPREAD)["ee_joint_state[0]"] == np.inf
