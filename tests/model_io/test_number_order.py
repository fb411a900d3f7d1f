"""Numbers that are told in another's place."""

from __future__ import annotations

from typing import Any

import numpy as np

from xpl_cli.model_io.difference import EpisodeAnswers, differences, spreads
from xpl_cli.model_io.number_order import order_patterns

RNG = np.random.default_rng(2)
STATES = RNG.uniform(-1, 1, (6, 4))
JOINTS = STATES[:, None] + np.cumsum(RNG.normal(size=(6, 5, 4)) * 0.1, axis=1)
GRIPS = RNG.uniform(0, 1, (6, 5, 2))


def _seen(joints: np.ndarray, grips: np.ndarray) -> list[tuple[str, str]]:
    def chunks(rows: np.ndarray, hands: np.ndarray) -> list[list[dict[str, Any]]]:
        return [
            [
                {"arm_joint_state": q, "left_ee_joint_state": g[:1], "right_ee_joint_state": g[1:]}
                for q, g in zip(*one, strict=True)
            ]
            for one in zip(rows, hands, strict=True)
        ]

    golden, answers = chunks(JOINTS, GRIPS), chunks(joints, grips)
    still = {"left_ee_joint_state": np.zeros(1), "right_ee_joint_state": np.zeros(1)}
    threads = [
        EpisodeAnswers([{"state": {"arm_joint_state": state, **still}}], [0], [one], [other])
        for state, one, other in zip(STATES, golden, answers, strict=True)
    ]
    before = differences(golden, answers, spreads(golden))
    return [(one.convention, one.words) for one in order_patterns(threads, before, 1e-4)]


def test_grippers_that_only_switch() -> None:
    ((convention, words),) = _seen(JOINTS, (GRIPS > 0.5).astype(float))
    assert convention == "gripper"
    assert "only ever 0 or 1" in words


def test_one_command_for_two() -> None:
    seen_patterns = _seen(JOINTS, GRIPS[..., [0, 0]])
    assert seen_patterns[0][0] == "gripper"
    assert "are always equal" in seen_patterns[0][1]


def test_changes_in_the_place_of_others() -> None:
    moved = STATES[:, None] + np.roll(JOINTS - STATES[:, None], -1, axis=-1)
    ((convention, words),) = _seen(moved, GRIPS)
    assert convention == "joint_order"
    assert "is in arm_joint_state[3] (and 3 more numbers)" in words


def test_other_numbers_are_none_of_them() -> None:
    assert _seen(RNG.normal(size=JOINTS.shape), GRIPS) == []
