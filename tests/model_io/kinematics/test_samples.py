"""Samples are read as the block says, within limits, and errors say where."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.recordings.arms import moments, rows
from xpl import get_embodiment, tables
from xpl.convert import ConversionError
from xpl_cli.model_io.kinematics import consistency, samples

if TYPE_CHECKING:
    from pathlib import Path

ROBOT = get_embodiment("franka_single")
STATES = moments(ROBOT, np.random.default_rng(0), 30)
JOINTS = [{"joints": {"arm": "single"}}]
POSE = [{"position": {"arm": "single"}}, {"rotation": {"arm": "single", "form": "quaternion_wxyz"}}]
MODEL_IO: dict[str, Any] = {
    "state": [{"input": "pose", "parts": POSE, "pad": 9}],
    "action": {"reference": "delta_state", "parts": POSE},
}


def _block(*entries: dict[str, Any]) -> dict[str, Any]:
    return {**MODEL_IO, "samples": list(entries)}


def test_rows_of_inputs_and_of_columns_beside_them_are_joined(tmp_path: Path) -> None:
    np.savez(tmp_path / "data.npz", **{"observation.pose": rows(POSE, "franka_single", STATES)})
    told = {"episode": {"joints": rows(JOINTS, "franka_single", STATES).tolist()}}
    (tmp_path / "data.json").write_text(json.dumps(told), encoding="utf-8")
    block = _block(
        {"file": "data.npz", "key": "observation/pose", "of": "pose"},
        {"file": "data.json", "key": "episode/joints", "parts": JOINTS},
    )
    columns_found = samples.collect(block, [tmp_path], ROBOT)
    assert [(one.kind, one.rows.shape, one.leads) for one in columns_found] == [
        ("position", (30, 3), False),
        ("rotation", (30, 4), False),
        ("joints", (30, 7), False),
    ]
    assert {verdict.outcome for verdict in consistency.judge(columns_found, ROBOT)} == {consistency.AGREES}


def test_deltas_are_no_witness(tmp_path: Path) -> None:
    """Where they start from is not in the row."""
    np.savez(tmp_path / "data.npz", action=rows(POSE, "franka_single", STATES))
    assert samples.collect(_block({"file": "data.npz", "key": "action", "of": "action"}), [tmp_path], ROBOT) == []


def test_long_recordings_are_thinned(tmp_path: Path) -> None:
    np.savez(tmp_path / "data.npz", q=np.arange(7000.0).reshape(1000, 7))
    block = _block({"file": "data.npz", "key": "q", "parts": JOINTS})
    (columns_found,) = samples.collect(block, [tmp_path], ROBOT)
    assert len(columns_found.rows) == 256
    assert (columns_found.rows[0, 0], columns_found.rows[-1, -1]) == (0, 6999)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.zeros((4, 6)), r"expected rows \(N, 7\), .* has the shape \(4, 6\)"),
        (np.zeros(7), r"has the shape \(7,\)"),
        (np.full((4, 7), np.nan), "not finite"),
        (np.array([["a"] * 7]), "no table of numbers"),
        (np.array([object()] * 7), "not a file of numpy arrays"),
    ],
)
def test_rows_that_do_not_fit_are_refused(values: np.ndarray, words: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "data.npz", q=values)
    with pytest.raises(ConversionError, match=words):
        samples.collect(_block({"file": "data.npz", "key": "q", "parts": JOINTS}), [tmp_path], ROBOT)


def test_entries_of_other_moments_are_refused(tmp_path: Path) -> None:
    """Row by row they would compare what does not belong together."""
    np.savez(tmp_path / "data.npz", pose=rows(POSE, "franka_single", STATES)[:20], q=np.zeros((30, 7)))
    block = _block({"file": "data.npz", "key": "pose", "of": "pose"}, {"file": "data.npz", "key": "q", "parts": JOINTS})
    with pytest.raises(ConversionError, match="20 and 30 rows"):
        samples.collect(block, [tmp_path], ROBOT)


def test_a_vector_that_is_not_there_and_a_missing_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConversionError, match="no vector 'state'; say one of pose, action, or parts"):
        samples.collect(_block({"file": "data.npz", "of": "state"}), [tmp_path], ROBOT)
    with pytest.raises(ConversionError, match=r"names the file data\.npz"):
        samples.collect(_block({"file": "data.npz", "of": "pose"}), [tmp_path], ROBOT)


def test_what_unpacks_to_more_than_memory_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few kilobytes may be a gigabyte of zeros."""
    monkeypatch.setattr(tables, "SIZE_LIMIT", 1000)
    np.savez_compressed(tmp_path / "data.npz", q=np.zeros((100, 7)))
    assert (tmp_path / "data.npz").stat().st_size < tables.SIZE_LIMIT
    with pytest.raises(ConversionError, match="unpacks to"):
        samples.collect(_block({"file": "data.npz", "key": "q", "parts": JOINTS}), [tmp_path], ROBOT)


def test_words_that_the_block_leaves_open_are_answered(tmp_path: Path) -> None:
    true = [{"position": {"arm": "single", "point": "tcp"}}, {"rotation": {"arm": "single", "form": "rot6d_columns"}}]
    why = {"unknown": "the paper does not say"}
    parts = [{"position": {"arm": "single", "point": why}}, {"rotation": {"arm": "single", "form": why}}]
    np.savez(tmp_path / "data.npz", pose=rows(true, "franka_single", STATES), q=rows(JOINTS, "franka_single", STATES))
    entries = [{"file": "data.npz", "key": "pose", "parts": parts}, {"file": "data.npz", "key": "q", "parts": JOINTS}]
    columns_found = samples.collect(_block(*entries), [tmp_path], ROBOT)
    _, position, rotation = consistency.judge(columns_found, ROBOT)
    assert position.outcome == rotation.outcome == consistency.ANSWERS
    assert position.change == "point: tcp"
    assert rotation.change == "form: rot6d_columns"
    assert "these rows tell what is open: form: rot6d_columns fits to 0 degrees" in rotation.sentence
