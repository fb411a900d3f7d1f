"""The progress of a run: lines without a terminal, a table on a terminal."""

from __future__ import annotations

import contextlib
import os
import pty
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.recordings.runs import Faults, synthetic_run
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.runs.progress import show_progress

if TYPE_CHECKING:
    import io
    from pathlib import Path

    from xpl_cli.evaluation.records.model import EpisodeRecord


@pytest.fixture
def run(tmp_path: Path) -> records.Run:
    """Return a run of 2 cells with 4 episodes each, of which 3 are completed, all with success."""
    faults = Faults(policy=0.0, retried=0.0)
    return records.read(synthetic_run(tmp_path, ["lift"], episodes=4, rate=1.0, played=3, faults=faults))


def _next(run: records.Run, index: int, **more: Any) -> EpisodeRecord:
    slot = run.plan.slots()[index]
    key = {"index": index, "task": slot.task, "setting": slot.setting, "seed": slot.seed}
    return replace(run.finals[0], **key, **more)


ERRORED = {"success": None, "failure": "infrastructure", "end_reason": "infrastructure", "error": "the server ended"}


def test_a_line_tells_what_happened_and_how_far_the_run_is(
    run: records.Run, capsys: pytest.CaptureFixture[str]
) -> None:
    """Episodes of an earlier process count, except for the pace."""
    with show_progress(run, 5) as view:
        view.add(_next(run, 3, final=False, wall_seconds=36.0, **ERRORED), 5)
        view.add(_next(run, 3), 4)
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("lift, clean, seed 3: infrastructure (the server ended), will be retried; 3 of 8 episodes")
    assert second.startswith("lift, clean, seed 3: success; 4 of 8 episodes, 4 of 4 succeeded (51 to 100 %), ")
    assert second.endswith("100 episodes/h, 2:24 left")  # one that took 36 s makes 100 an hour


def _all_of(terminal: io.FileIO) -> str:
    """Return what was written to a terminal that was closed since; it arrives in pieces, and ends in an error."""
    pieces = []
    with contextlib.suppress(OSError):
        while piece := terminal.read(1 << 16):
            pieces.append(piece)
    return b"".join(pieces).decode()


def test_a_terminal_shows_cells_and_the_last_failure(run: records.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    ours, theirs = pty.openpty()
    with os.fdopen(ours, "rb", buffering=0) as terminal_output:
        with os.fdopen(theirs, "w") as terminal:
            monkeypatch.setattr(sys, "stderr", terminal)
            with show_progress(run, 5) as view:
                view.add(_next(run, 3, **ERRORED), 4)
        text = _all_of(terminal_output)
    for part in ("clean", "4/4", "randomized", "0/4", "3 of 3 succeeded", "last failure: lift, clean, seed 3"):
        assert part in text
