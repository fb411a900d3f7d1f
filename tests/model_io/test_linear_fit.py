"""Commands that are a straight line of the golden ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from xpl_cli.model_io.difference import EpisodeAnswers, differences, spreads
from xpl_cli.model_io.linear_fit import fit_linear

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl_cli.model_io.explain import TriedChange

RNG = np.random.default_rng(0)
STATES = RNG.uniform(-1, 1, (6, 2))
GOLDEN = STATES[:, None] + RNG.normal(size=(6, 4, 2)) * 0.1
GRIPS = RNG.uniform(-0.4, 1.4, (6, 4, 1)).clip(0, 1)


def _chunks(joints: np.ndarray, grips: np.ndarray = GRIPS) -> list[list[dict[str, np.ndarray]]]:
    return [
        [{"arm_joint_state": q, "ee_joint_state": g} for q, g in zip(rows, hands, strict=True)]
        for rows, hands in zip(joints, grips, strict=True)
    ]


def _fitted(joints: np.ndarray, grips: np.ndarray = GRIPS) -> TriedChange | None:
    golden, answers = _chunks(GOLDEN), _chunks(joints, grips)
    states = [{"arm_joint_state": state, "ee_joint_state": np.zeros(1)} for state in STATES]
    threads = [
        EpisodeAnswers([{"state": state}], [0], [one], [other])
        for state, one, other in zip(states, golden, answers, strict=True)
    ]
    spread = spreads(golden)
    return fit_linear(threads, differences(golden, answers, spread), spread, 1e-4)


@pytest.mark.parametrize(
    ("change", "convention", "words"),
    [
        (lambda q: 2 * q + 0.5, "normalization", "golden = 0.5 * answer -0.25"),
        (np.rad2deg, "angle_unit", "golden = 0.01745 * answer"),
        (lambda q: -q, "joint_order", "golden = -1 * answer"),
        (
            lambda q: STATES[:, None] + 3 * (q - STATES[:, None]),
            "normalization",
            "golden = 0.3333 * change of the state",
        ),
    ],
)
def test_a_scale_is_found(change: Callable[[Any], Any], convention: str, words: str) -> None:
    fit = _fitted(change(GOLDEN))
    assert fit is not None
    assert fit.convention == convention
    assert words in fit.words
    assert fit.words.endswith("(and 1 more numbers)")
    assert max(fit.remaining.values()) < 1e-4


def test_clipped_openings_do_not_count() -> None:
    fit = _fitted(GOLDEN, GRIPS * 0.5)
    assert fit is not None
    assert (fit.convention, fit.words) == ("gripper", "ee_joint_state[0]: golden = 2 * answer")


def test_what_is_no_line_is_not_found() -> None:
    assert _fitted(GOLDEN**2) is None
    assert _fitted(np.concatenate((GOLDEN[..., :1] * 2, GOLDEN[..., 1:] ** 3), -1)) is None
    assert _fitted(RNG.normal(size=GOLDEN.shape)) is None
