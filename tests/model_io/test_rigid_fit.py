"""Commanded poses that are a constant away from the golden ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from xpl import poses, rotation
from xpl_cli.model_io.difference import EpisodeAnswers, differences, spreads
from xpl_cli.model_io.rigid_fit import fit_rigid

if TYPE_CHECKING:
    from xpl_cli.model_io.explain import TriedChange

RNG = np.random.default_rng(4)
TOOL = np.concatenate(([0.0, 0.0, 0.1], rotation.from_axis_angle([0.0, 0.0, -0.8])))
OTHER = np.concatenate(([0.2, -0.5, 0.7], rotation.from_axis_angle([0.3, 0.0, 1.2])))


def _some(count: int, far: float) -> np.ndarray:
    return np.concatenate(
        (far * RNG.normal(size=(count, 3)), rotation.from_axis_angle(far * RNG.normal(size=(count, 3)))), axis=-1
    )


STATES = _some(5, 0.6)
STARTS = np.repeat(STATES, 4, axis=0)
CHANGES = _some(20, 0.1)


def _applied(change: np.ndarray, place: str = "fixed", turn: str = "fixed", point: Any = None) -> np.ndarray:
    start = STARTS if point is None else poses.compose(STARTS, point)
    move = change[:, :3] if place == "fixed" else rotation.rotate(start[:, 3:], change[:, :3])
    pair = (change[:, 3:], start[:, 3:]) if turn == "fixed" else (start[:, 3:], change[:, 3:])
    made = np.concatenate((start[:, :3] + move, rotation.multiply(*pair)), axis=-1)
    return made if point is None else poses.compose(made, poses.invert(point))


def _found(wanted: np.ndarray, answers: np.ndarray) -> list[TriedChange]:
    def chunks(rows: np.ndarray) -> list[list[dict[str, Any]]]:
        return [[{"ee_pose": row} for row in chunk] for chunk in rows.reshape(5, 4, 7)]

    golden, told = chunks(wanted), chunks(answers)
    threads = [
        EpisodeAnswers([{"state": {"ee_pose": state}}], [0], [one], [other])
        for state, one, other in zip(STATES, golden, told, strict=True)
    ]
    spread = spreads(golden)
    tried = fit_rigid(threads, differences(golden, told, spread), spread, 1e-4, TOOL)
    return [one for one in tried if max(one.remaining.values()) < 1e-6]


@pytest.mark.parametrize(
    ("wanted", "answers", "convention"),
    [
        (poses.compose(OTHER, _applied(CHANGES)), _applied(CHANGES), "frame"),
        (poses.compose(_applied(CHANGES), OTHER), _applied(CHANGES), "point"),
        (_applied(CHANGES), _applied(CHANGES, turn="body"), "action_reference"),
        (_applied(CHANGES, point=TOOL), _applied(CHANGES, place="body", point=TOOL), "action_reference"),
        (_applied(CHANGES * [2, 2, 2, 1, 1, 1, 1]), _applied(CHANGES), "normalization"),
        (_applied(CHANGES[:, [1, 0, 2, 3, 4, 5, 6]]), _applied(CHANGES), "frame"),
    ],
)
def test_a_constant_is_found(wanted: np.ndarray, answers: np.ndarray, convention: str) -> None:
    fits = _found(wanted, answers)
    assert fits
    assert fits[0].convention == convention, [one.words for one in fits]


def test_what_is_no_constant_is_not_found() -> None:
    assert not _found(_applied(CHANGES), _applied(_some(20, 0.1)))
