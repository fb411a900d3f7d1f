"""Sets of many episodes: all cores look, no more waits than is taken, and the report is that of one process."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from xpl.trajectory import Writer
from xpl_cli.audit.demonstrations import validation
from xpl_cli.audit.demonstrations.validation import ValidationOptions, validate
from xpl_cli.basics import parallel
from xpl_cli.data.reading import open_set

if TYPE_CHECKING:
    import pytest


def test_the_report_of_many_processes_is_that_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Findings name the same episodes in the same order, and the digest is the same."""
    for number in range(validation._MANY + 1):
        with Writer(tmp_path / f"episode_{number:07d}.hdf5", frequency=10.0) as episode:
            row = np.full(2, np.nan if number in {3, 20} else number, np.float32)
            episode.add({"state": {"arm_joint_state": row}, "instruction": "go"}, {"arm_joint_state": row})
    options = ValidationOptions(names=("XPL701", "XPL706", "XPL711"))
    many = validate(open_set(tmp_path), "demos", options).gates[0]
    monkeypatch.setattr(parallel, "map_in_processes", None)
    monkeypatch.setattr(validation, "_MANY", 1000)
    one = validate(open_set(tmp_path), "demos", options).gates[0]
    assert (many.results, many.digest) == (one.results, one.digest)
    assert "episode_0000003" in many.results[1].findings[0].message


def test_of_nothing_nothing_is_made() -> None:
    """As by a conversion that ended after its last episode and goes on."""
    assert list(parallel.map_in_processes(str, [])) == []


def test_things_are_handed_out_as_answers_are_taken(tmp_path: Path) -> None:
    answers = parallel.map_in_processes(functools.partial(_noted, tmp_path), range(1000), 1)
    assert next(answers) == 0
    answers.close()  # type: ignore[attr-defined]
    assert 1 <= len(list(tmp_path.iterdir())) <= parallel._AHEAD + 1


def _noted(folder: Path, number: int) -> int:
    (folder / str(number)).touch()
    return number
