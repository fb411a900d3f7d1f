"""The file of pairs: written and read again, deterministic, and refused where it is not what it should be."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xpl_cli.basics.errors import UserError
from xpl_cli.model_io import names, pairs, script
from xpl_cli.model_io.pairs import GoldenPairs, PairsError, PairSession

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PROVENANCE = {
    "reference": {"reference.py": "0" * 64},
    "weights": None,
    "settings": {},
    "commit": None,
    "python": "3.11.0",
    "libraries": {},
    "noise": {"ee_joint_state": 0.0},
}


def session(
    seed: int = 0, takes: int = 1, steps: int = 2, calls: tuple[script.Call, ...] = script.short_script()
) -> PairSession:
    """Return a session with made-up answers."""
    rng = np.random.default_rng(seed)
    dims = {"arm_joint_state": 7, "ee_joint_state": 1}
    answers = tuple(
        tuple({key: rng.random((takes, steps, width), np.float32) for key, width in dims.items()} for _ in call.ask)
        for call in calls
        if call.ask
    )
    return PairSession("franka_single", "joint", seed, {"cam_head": (12, 16)}, takes, calls, answers)


@settings(max_examples=10, derandomize=True, deadline=None)
@given(
    st.integers(0, 1000),
    st.integers(1, 3),
    st.integers(1, 4),
    st.sampled_from([script.short_script(), script.full_script(3)]),
)
def test_what_was_written_is_read(
    tmp_path_factory: pytest.TempPathFactory, seed: int, takes: int, steps: int, calls: tuple[script.Call, ...]
) -> None:
    folder = tmp_path_factory.mktemp("pairs")
    made = GoldenPairs(PROVENANCE, (session(seed, takes, steps, calls), session(seed + 1)))
    size = pairs.write(folder, made)
    data = (folder / names.PAIRS).read_bytes()
    assert len(data) == size
    read_pairs = pairs.read(folder)
    assert read_pairs.provenance == made.provenance
    assert read_pairs.count == made.count == sum(len(call.ask) for one in made.sessions for call in one.calls)
    for one, other in zip(read_pairs.sessions, made.sessions, strict=True):
        assert replace(one, answers=()) == replace(other, answers=())
        for question, same in zip(one.questions, other.questions, strict=True):
            assert all(np.array_equal(question.answer[key], values) for key, values in same.answer.items())
    pairs.write(folder, read_pairs)
    assert (folder / names.PAIRS).read_bytes() == data


def test_questions_know_what_was_shown_before() -> None:
    read_pairs = session().questions
    assert [(one.env, one.episode, one.asked_at, [place for _, place in one.recipes]) for one in read_pairs] == [
        (0, 0, (0,), [0]),
        (2, 0, (0,), [0]),
        (0, 0, (0, 2), [0, 1, 2]),
        (2, 1, (0,), [100]),
    ]
    assert len(session(steps=3).chunk(read_pairs[0])) == 2


def _changed(change: Callable[[dict[str, Any]], Any], folder: Path) -> None:
    pairs.write(folder, GoldenPairs(PROVENANCE, (session(),)))
    document = json.loads((folder / names.PAIRS).read_bytes())
    change(document)
    (folder / names.PAIRS).write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda told: told.pop("provenance"), "provenance"),
        (lambda told: told.update(script=1), "version 1 of the script"),
        (lambda told: told["sessions"][0].update(embodiment="nobody"), "unknown embodiment"),
        (lambda told: told["sessions"][0]["calls"][2].update(ask=[1]), "which has no observation"),
        (
            lambda told: told["sessions"][0]["calls"][2].update(answers=told["sessions"][0]["calls"][2]["answers"] * 2),
            "lacks",
        ),
        (lambda told: told["sessions"][0]["calls"].append({"reset": True, "show": [[0, 1]]}), "none of reset"),
        (lambda told: _array(told).update(shape=[1, 2, 6]), "expected [1, 2, 6] numbers"),
        (lambda told: _array(told).update(shape=[1000000, 1000000, 1000000]), "bytes"),
        (lambda told: _array(told).update(float32="&"), "no base64"),
        (
            lambda told: _array(told).update(
                float32="AADAfwAAwH8AAMB/AADAfwAAwH8AAMB/AADAfwAAwH8AAMB/AADAfwAAwH8AAMB/AADAfwAAwH8="
            ),
            "not finite",
        ),
        (lambda told: told["sessions"][0]["calls"][2]["answers"][0].pop("ee_joint_state"), "shapes"),
    ],
)
def test_a_file_that_was_changed_is_refused(change: Callable[[dict[str, Any]], Any], told: str, tmp_path: Path) -> None:
    _changed(change, tmp_path)
    with pytest.raises(PairsError) as caught:
        pairs.read(tmp_path)
    assert told in str(caught.value)


def _array(document: dict[str, Any]) -> dict[str, Any]:
    read_pairs: dict[str, Any] = document["sessions"][0]["calls"][2]["answers"][0]["arm_joint_state"]
    return read_pairs


@pytest.mark.parametrize("content", [b"", b"[" * 100_000, b"\xff", b"NaN", b"[1]"])
def test_a_file_that_is_no_recording_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / names.PAIRS).write_bytes(content)
    with pytest.raises(PairsError):
        pairs.read(tmp_path)


def test_a_file_that_is_too_large_is_neither_read_nor_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pairs.write(tmp_path, GoldenPairs(PROVENANCE, (session(),)))
    monkeypatch.setattr(names, "PAIRS_BYTES", 1000)
    with pytest.raises(PairsError, match="cannot be read"):
        pairs.read(tmp_path)
    with pytest.raises(UserError, match=r"temporal\.chunk"):
        pairs.write(tmp_path, GoldenPairs(PROVENANCE, (session(),)))
