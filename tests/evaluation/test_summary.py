"""What a run's record adds up to."""

from __future__ import annotations

import json
import random
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.recordings.runs import Faults, rewritten, synthetic_run
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.runs.stopping import stopping_point
from xpl_cli.evaluation.statistics import intervals, wording
from xpl_cli.evaluation.statistics.summary import summarise
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from pathlib import Path

Line = dict[str, Any]


def summary_of(folder: Path, method: str = "wilson") -> dict[str, Any]:
    """Return the summary of a recorded run, validated against its schema and rendered."""
    summary = summarise(records.read(folder), method)
    document = summary.as_json()
    assert [str(problem) for problem in validate(document, "summary")] == []
    assert wording.text(summary)
    return document


def results(summary: dict[str, Any]) -> dict[str, Any]:
    """Return what follows from results alone."""
    return {key: value for key, value in summary.items() if key != "execution"}


def test_rows_count_completed_episodes(tmp_path: Path) -> None:
    """Cells in the order of the plan, and sums over them."""
    report = summary_of(synthetic_run(tmp_path / "run", episodes=25, faults=Faults(policy=0.1)))
    assert [(row["task"], row["setting"]) for row in report["cells"]] == [
        ("lift_cube", "clean"), ("lift_cube", "randomized"), ("stack_cubes", "clean"), ("stack_cubes", "randomized"),
    ]  # fmt: skip
    overall = report["overall"]
    assert (overall["planned"], overall["completed"], overall["judged"], overall["remaining"]) == (100, 100, 100, 0)
    assert overall["successes"] == sum(row["successes"] for row in report["cells"])
    assert overall["successes"] + sum(overall["failures"].values()) == 100
    assert overall["failures"]["policy"] > 0
    assert [row["task"] for row in report["tasks"]] == ["lift_cube", "stack_cubes"]
    assert [row["setting"] for row in report["settings"]] == ["clean", "randomized"]
    assert [row["dimension"] for row in report["dimensions"]] == ["precision", "long-horizon"]
    assert {row["setting"] for row in report["tasks"]} == {None}


def test_the_exact_interval_is_at_hand(tmp_path: Path) -> None:
    folder = synthetic_run(tmp_path / "run", tasks=["lift_cube"], settings=["clean"])
    usual, exact = summary_of(folder), summary_of(folder, "exact")
    row = exact["overall"]
    assert row["success_interval"] == pytest.approx(list(intervals.clopper_pearson(row["successes"], row["judged"])))
    assert exact["methods"]["success"] == "exact"
    assert row["success_interval"][0] < usual["overall"]["success_interval"][0]


def test_results_do_not_depend_on_the_order_in_which_episodes_ended(tmp_path: Path) -> None:
    """Nor on what was tried before: several workers and a resumed run give the same table, byte for byte."""
    folder = synthetic_run(tmp_path / "run", faults=Faults(retried=0.2))
    before = summary_of(folder)

    def shuffled(lines: list[Line]) -> list[Line]:
        firsts = [line for line in lines if not line["final"]]
        finals = [line for line in lines if line["final"]]
        random.Random(1).shuffle(finals)  # noqa: S311 - an order, not a secret
        first_indices = {line["index"] for line in firsts[::2]}
        return [*firsts[::2], *({**line, "attempt": 1 + (line["index"] in first_indices)} for line in finals)]

    after = summary_of(rewritten(folder, shuffled))
    assert json.dumps(results(after)) == json.dumps(results(before))
    assert after["execution"]["retried"] < before["execution"]["retried"]


def test_infrastructure_errors_count_as_failed_and_are_reported(tmp_path: Path) -> None:
    """The rate is of all episodes, and the bounds of what it might have been stand beside it."""
    report = summary_of(synthetic_run(tmp_path / "run", faults=Faults(infrastructure=0.1)))
    row = report["overall"]
    errors = row["failures"]["infrastructure"]
    assert errors > 0
    assert row["judged"] + errors == row["completed"] == 80
    worst, best = row["infrastructure_bounds"]
    assert worst == row["success_rate"] == pytest.approx(row["successes"] / 80)
    assert best == pytest.approx((row["successes"] + errors) / 80)
    (note,) = (
        note for note in report["notes"] if note.startswith(f"{errors} episodes ended with an infrastructure error")
    )
    assert f"without them {row['successes']} of {row['judged']} succeeded" in note
    assert summary_of(synthetic_run(tmp_path / "other"))["overall"]["infrastructure_bounds"] is None
    nothing = summary_of(synthetic_run(tmp_path / "nothing", faults=Faults(infrastructure=1.0)))
    assert (nothing["overall"]["success_rate"], nothing["overall"]["infrastructure_bounds"]) == (None, None)
    assert nothing["notes"][0] == "80 episodes ended with an infrastructure error: they have no result."


def test_a_task_with_nothing_but_infrastructure_errors_counts_as_failed(tmp_path: Path) -> None:
    """Leaving it out would reward a policy that breaks the hard ones."""
    folder = synthetic_run(tmp_path / "run", settings=["clean"], episodes=20, rate={("lift_cube", "clean"): 1.0,
                       ("stack_cubes", "clean"): 0.0}, faults=Faults(policy=0.0, retried=0.0))  # fmt: skip

    def spoiling(lines: list[Line]) -> list[Line]:
        errors = {"success": None, "score": None, "failure": "infrastructure", "end_reason": "infrastructure"}
        return [line | (errors if line["task"] == "stack_cubes" else {}) for line in lines]

    report = summary_of(rewritten(folder, spoiling))
    assert [row["success_rate"] for row in report["cells"]] == [1.0, 0.0]
    assert report["overall"]["success_rate"] == report["overall"]["mean_score"] == 0.5


def test_a_success_after_the_policys_process_died_is_not_counted(tmp_path: Path) -> None:
    """Dying in every attempt that goes wrong must not be a second chance."""
    folder = synthetic_run(
        tmp_path / "run", ["lift_cube"], ["clean"], 20, rate=1.0, faults=Faults(policy=0.0, retried=0.0)
    )

    def reviving(lines: list[Line]) -> list[Line]:
        head, *rest = lines
        died = {"success": False, "failure": "policy", "end_reason": "policy_died", "error": "exit code 0"}
        return [{**head, **died, "final": False}, {**head, "attempt": 2}, *rest]

    report = summary_of(rewritten(folder, reviving))
    assert (report["overall"]["successes"], report["overall"]["success_rate"]) == (20, 0.95)
    assert report["overall"]["infrastructure_bounds"] == [0.95, 1.0]
    assert any("only after the policy's process had crashed" in note for note in report["notes"])


def test_a_policy_that_fails_has_not_succeeded_and_has_no_score(tmp_path: Path) -> None:
    """Whatever an environment made of the episode: leaving it out would reward errors."""
    folder = synthetic_run(tmp_path / "run", tasks=["lift_cube"], settings=["clean"], episodes=20, rate=1.0)

    def failing(lines: list[Line]) -> list[Line]:
        for line in lines[:5]:
            line.update(success=None, score=None, failure="policy", error="no action", end_reason="policy_error")
        return lines

    row = summary_of(rewritten(folder, failing))["overall"]
    assert (row["judged"], row["success_rate"]) == (20, 0.75)
    assert row["mean_score"] == pytest.approx(0.75)


def test_an_environment_without_success_has_no_rate(tmp_path: Path) -> None:
    folder = synthetic_run(tmp_path / "run", tasks=["lift_cube"], settings=["clean"])

    def driving(lines: list[Line]) -> list[Line]:
        return [{**line, "success": None, "score": None, "failure": None} for line in lines if line["final"]]

    report = summary_of(rewritten(folder, driving))
    row = report["overall"]
    assert (row["success_rate"], row["success_interval"], row["mean_score"], row["judged"]) == (None, None, None, 0)
    assert row["completed"] == 20
    assert any(note.startswith("No episode defines success in lift_cube (clean)") for note in report["notes"])


def test_an_unfinished_run_is_reported(tmp_path: Path) -> None:
    """A cell without any episode takes no part in the means."""
    report = summary_of(synthetic_run(tmp_path / "run", episodes=10, played=12))
    assert [row["completed"] for row in report["cells"]] == [10, 2, 0, 0]
    assert report["overall"]["remaining"] == 28
    assert report["cells"][2]["success_rate"] is None
    mean = (report["cells"][0]["success_rate"] + report["cells"][1]["success_rate"]) / 2
    assert report["overall"]["success_rate"] == pytest.approx(mean)
    assert report["notes"][0].startswith("28 episodes of 40 still to be run")
    assert any("means of the rates" in note for note in report["notes"])


def test_episodes_after_the_end_of_a_cell_do_not_count(tmp_path: Path) -> None:
    """A run that stops at narrow intervals has one result, however many episodes were running."""
    cell: dict[str, Any] = {"tasks": ["lift_cube"], "settings": ["clean"], "episodes": 60, "rate": 0.95}
    whole = summary_of(rewritten(synthetic_run(tmp_path / "whole", **cell), until_width=0.3))
    row = whole["overall"]
    outcomes = [line.success for line in records.read(tmp_path / "whole").finals.values()]
    assert row["judged"] == stopping_point(outcomes, 0.3)
    assert (row["remaining"], whole["execution"]["beyond"]) == (0, 60 - row["judged"])
    assert "do not count" in whole["execution"]["notes"][0]
    assert any("Tasks ended as soon as" in note for note in whole["notes"])

    def cut(lines: list[Line]) -> list[Line]:
        return [line for line in lines if line["index"] < row["completed"]]

    short = summary_of(rewritten(synthetic_run(tmp_path / "short", **cell), cut, until_width=0.3))
    assert json.dumps(results(short)) == json.dumps(results(whole))


def test_a_gap_keeps_a_cell_from_ending(tmp_path: Path) -> None:
    """An episode after a remaining one does not decide whether the cell has ended."""
    folder = synthetic_run(tmp_path / "run", ["lift_cube"], ["clean"], 60, rate=0.95)

    def gap(lines: list[Line]) -> list[Line]:
        return [line for line in lines if line["index"] != 3]

    report = summary_of(rewritten(folder, gap, until_width=0.3))
    assert (report["overall"]["completed"], report["overall"]["remaining"], report["execution"]["beyond"]) == (59, 1, 0)


def test_settings_are_held_against_the_first(tmp_path: Path) -> None:
    """By seed, since equal seeds have equal layouts; over all tasks, the mean."""
    rates = {(task, setting): 0.9 if setting == "clean" else 0.3
             for task in ("lift_cube", "stack_cubes") for setting in ("clean", "randomized")}  # fmt: skip
    report = summary_of(synthetic_run(tmp_path / "run", episodes=40, rate=rates))
    each, overall = report["contrasts"][:2], report["contrasts"][2]
    assert [row["task"] for row in report["contrasts"]] == ["lift_cube", "stack_cubes", None]
    assert all(row["settings"] == ["clean", "randomized"] and row["pairs"] == 40 for row in each)
    assert overall["difference"] == pytest.approx(sum(row["difference"] for row in each) / 2)
    assert overall["interval"][1] < -0.3
    by_setting = [row["success_rate"] for row in report["settings"]]
    assert overall["difference"] == pytest.approx(by_setting[1] - by_setting[0])


def test_execution_is_separate_from_results(tmp_path: Path) -> None:
    """Retries, errors, and latency as exactly as a histogram allows."""
    folder = synthetic_run(tmp_path / "run", faults=Faults(retried=0.3))
    execution = summary_of(folder)["execution"]
    assert execution["attempts"] == 80 + execution["retried"]
    assert execution["errors"][0]["count"] >= execution["retried"] > 0

    def timed(lines: list[Line]) -> list[Line]:
        for line in lines:
            line["inference"] = {"count": 10, "seconds": 0.1, "histogram": [0, 0, 9, 0, 0, 0, 0, 0, 1, 0]}
        return lines

    inference = summary_of(rewritten(folder, timed))["execution"]["inference"]
    assert 0.002 < inference["p50"] < 0.003
    assert 0.016 < inference["p95"] < inference["p99"] < 0.023
