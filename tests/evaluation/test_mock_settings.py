"""Runs with a mock of a part of a benchmark: reports say so, and nothing takes them for the benchmark's results."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest

from tests.support.recordings.runs import episode, synthetic_run
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.evaluation.leaderboard import comparable_runs, export, result_trees
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.report import markdown
from xpl_cli.evaluation.runs.evaluation import EvalSetup, Evaluation
from xpl_cli.evaluation.statistics.comparison import compare
from xpl_cli.evaluation.statistics.summary import summarise
from xpl_cli.submission import prepare

if TYPE_CHECKING:
    from pathlib import Path

SETTING = "stand_in_robot"
SAID = "by a mock"


def _run(folder: Path, policy: str = "Foo", settings: tuple[str, ...] = (SETTING,)) -> records.Run:
    return records.read(
        synthetic_run(folder / policy, tasks=("lift_cube",), settings=settings, episodes=4, policy=policy)
    )


def test_every_report_begins_with_the_remark(tmp_path: Path) -> None:
    """Summary, page, comparison, and what `xpl eval` prints; of a usual run none does."""
    run = _run(tmp_path)
    run_summary = summarise(run)
    assert SAID in run_summary.notes[0]
    assert SETTING in run_summary.notes[0]
    assert SAID in markdown.render(run, run_summary).splitlines()[2]
    assert SAID in compare(run, _run(tmp_path, "Bar")).notes[0]
    usual = summarise(_run(tmp_path, "Usual", ("clean",)))
    assert not any(SAID in note for note in usual.notes)


@pytest.mark.parametrize(("setting", "is_said"), [(SETTING, True), ("clean", False)])
@pytest.mark.parametrize("rate", [None, 1.0])
def test_an_evaluation_has_the_remark_beside_its_figure(setting: str, is_said: bool, rate: float | None) -> None:
    played = EvalSetup("x", "x", "x", setting, "x", "joint")
    evaluation = Evaluation(played, [episode(success=None if rate is None else True, score=rate)])
    assert evaluation.success_rate == rate
    assert (SAID in evaluation.text()) is is_said


def test_no_leaderboard_takes_it(tmp_path: Path) -> None:
    """Not beside others, not alone, not with --anyway, and not if only one of several settings is a mock."""
    usual, mixed = _run(tmp_path, "Usual", ("clean",)), _run(tmp_path, "Mixed", ("clean", SETTING))
    for runs in ([_run(tmp_path)], [usual, mixed]):
        with pytest.raises(UserError, match=rf"is not ranked\. {SETTING} replaces a part of .* {SAID}") as refused:
            comparable_runs.gather(runs, anyway=True)
        assert refused.value.code == ExitCode.NOT_RUN


@pytest.mark.parametrize("name", list(export.FORMATS))
def test_no_result_file_is_written_of_it(tmp_path: Path, name: str) -> None:
    with pytest.raises(UserError, match="is not written as a result"):
        export.write(name, [_run(tmp_path)], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_result_file_in_such_a_folder_is_none(tmp_path: Path) -> None:
    """From whatever source: RoboTwin's folders name the setting."""
    file = tmp_path / "stack_blocks_two" / "Foo" / SETTING / "ckpt" / "2026-11-23 00:00:00" / "_result.txt"
    file.parent.mkdir(parents=True)
    file.write_text("1.0\n")
    with pytest.raises(UserError, match=SAID):
        result_trees.read([tmp_path])
    with pytest.raises(NotFoundError):
        result_trees.read([tmp_path], skip=True)


def test_it_is_not_submitted(tmp_path: Path) -> None:
    run = _run(tmp_path)
    request = prepare.SubmitRequest(SimpleNamespace(name="Foo"), (run.folder,), tmp_path / "bundle")  # type: ignore[arg-type]
    with pytest.raises(UserError, match="is not submitted"):
        prepare.submit(request)
