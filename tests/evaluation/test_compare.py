"""`xpl compare`: two runs on their common episodes."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.checkout import ROOT
from tests.support.commands import xpl
from tests.support.recordings.runs import Faults, rewritten, synthetic_run
from xpl_cli.basics.errors import ExitCode
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.statistics import intervals, verdicts
from xpl_cli.evaluation.statistics.comparison import IncomparableError, compare
from xpl_cli.evaluation.statistics.comparison_model import Comparison
from xpl_cli.evaluation.statistics.intervals import PairedCounts
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from pathlib import Path

Line = dict[str, Any]
ONE: dict[str, Any] = {"tasks": ["lift_cube"], "settings": ["clean"]}


def compared(first: Path, second: Path) -> dict[str, Any]:
    """Return the comparison of two recorded runs, validated against its schema and rendered."""
    result = compare(records.read(first), records.read(second))
    comparison = result.as_json()
    assert [str(problem) for problem in validate(comparison, "comparison")] == []
    assert verdicts.text(result)
    return comparison


@pytest.fixture
def runs(tmp_path: Path) -> tuple[Path, Path]:
    """A run of Foo, and one of Bar, which is better."""
    foo = synthetic_run(tmp_path / "foo", episodes=30, rate=0.4, policy="Foo")
    return foo, synthetic_run(tmp_path / "bar", episodes=30, rate=0.75, policy="Bar")


def test_the_better_policy_is_named_with_its_margin(runs: tuple[Path, Path]) -> None:
    """On pairs with equal seeds, by the exact test; for each task the p-values are corrected."""
    comparison = compared(*runs)
    rows, overall = comparison["cells"], comparison["overall"]
    assert comparison["verdict"].startswith("Bar is better than Foo: ")
    assert overall["pairs"] == sum(row["pairs"] for row in rows) == 120
    table = PairedCounts(*(overall[name] for name in PairedCounts._fields))
    assert overall["p_value"] == intervals.mcnemar(table) < 0.001
    assert overall["difference"] == pytest.approx(overall["second_rate"] - overall["first_rate"])
    assert overall["interval"][0] > 0.1
    assert overall["score_interval"][0] > 0
    assert [row["adjusted_p_value"] for row in rows] == intervals.holm([row["p_value"] for row in rows])


def test_no_significant_difference_is_not_called_equality(tmp_path: Path) -> None:
    foo = synthetic_run(tmp_path / "foo", **ONE, episodes=20, rate=0.5, policy="Foo")
    bar = synthetic_run(tmp_path / "bar", **ONE, episodes=20, rate=0.55, policy="Bar")
    comparison = compared(foo, bar)
    low, high = comparison["overall"]["interval"]
    assert low < 0 < high
    assert comparison["verdict"].startswith("Neither is shown to be better: Foo has")
    assert (
        f"Anything from {round(low * 100):+d} to {round(high * 100):+d} points for Bar fits these data."
        in comparison["verdict"]
    )


def test_a_repeated_run_is_recognised(tmp_path: Path) -> None:
    """It is no evidence about anything but repeatability."""
    first = synthetic_run(tmp_path / "first")
    again = tmp_path / "again"
    shutil.copytree(first, again)
    comparison = compared(first, again)
    assert comparison["verdict"].startswith(f"{first} and {again} succeeded in the same episodes: ")
    assert comparison["same_trajectories"] == comparison["overall"]["pairs"]
    moved = compared(first, rewritten(again, lambda lines: [*lines[:-1], {**lines[-1], "digest": "0" * 64}]))
    assert moved["same_trajectories"] == comparison["same_trajectories"] - 1


def test_infrastructure_errors_are_compared_as_failed_and_others_only_where_both_have_them(tmp_path: Path) -> None:
    """Seeds that one run lacks are left out and reported; an infrastructure error is no success."""
    foo = synthetic_run(tmp_path / "foo", **ONE, episodes=40, policy="Foo", rate=1.0, faults=Faults(infrastructure=0.2))
    bar = synthetic_run(
        tmp_path / "bar", **ONE, episodes=30, policy="Bar", rate=1.0, first_seed=5, faults=Faults(policy=0)
    )
    comparison = compared(foo, bar)
    errors = [line.seed for line in records.read(foo).finals.values() if line.failure == "infrastructure"]
    row = comparison["overall"]
    assert row["pairs"] == 30
    assert row["only_second"] >= sum(5 <= seed < 35 for seed in errors) > 0
    assert comparison["left_out"] == {"first": 10, "second": 0}
    assert [entry["what"] for entry in comparison["differences"]] == ["seeds of lift_cube (clean)"]


def test_differences_besides_the_policy_are_reported(runs: tuple[Path, Path]) -> None:
    control = {"horizon": None, "attempts": 3}
    comparison = compared(runs[0], rewritten(runs[1], action_type="ee", control=control, until_width=0.5))
    assert {entry["what"] for entry in comparison["differences"]} == {
        "control", "executed actions of a chunk", "width at which a task ends",
    }  # fmt: skip


def test_tasks_that_one_run_lacks_are_reported(tmp_path: Path) -> None:
    foo = synthetic_run(tmp_path / "foo", policy="Foo")
    comparison = compared(foo, synthetic_run(tmp_path / "bar", ["lift_cube"], ["clean", "other"], policy="Bar"))
    assert [(row["task"], row["setting"]) for row in comparison["cells"]] == [("lift_cube", "clean")]
    (entry,) = comparison["differences"]
    assert entry["second"] == "lift_cube (other)"


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (
            {"environment": {"name": "other", "spec": "v1", "digest": "0" * 64}},
            "different environments: mujoco and other",
        ),
        ({}, "the runs have no episode in common"),
    ],
)
def test_runs_that_have_nothing_in_common_are_refused(tmp_path: Path, change: dict[str, Any], complaint: str) -> None:
    foo = synthetic_run(tmp_path / "foo", policy="Foo")
    bar = rewritten(synthetic_run(tmp_path / "bar", policy="Bar", first_seed=0 if change else 100), **change)
    with pytest.raises(IncomparableError, match=complaint) as caught:
        compared(foo, bar)
    assert caught.value.code is ExitCode.NOT_RUN


def test_equal_seeds_that_drew_other_scenes_are_refused(runs: tuple[Path, Path]) -> None:
    """They are no pairs, whatever their number; without layouts in the records, this is taken on trust."""
    elsewhere = {"layout": {"cube": [9, 9]}}
    moved = rewritten(runs[1], lambda lines: [line | (elsewhere if line["seed"] == 7 else {}) for line in lines])
    with pytest.raises(IncomparableError, match=r"in 4 common episodes .* first in lift_cube \(clean\), seed 7"):
        compared(runs[0], moved)
    comparison = compared(runs[0], rewritten(runs[1], lambda lines: [{**line, "layout": None} for line in lines]))
    assert comparison["known_layouts"] == 0


def test_exit_codes(tmp_path: Path) -> None:
    for name in ("foo", "bar"):
        synthetic_run(tmp_path / name, **ONE, episodes=3)
    done = xpl("compare", "foo", "bar/records.jsonl", "--json", folder=tmp_path)
    assert (done.code, done.stderr, json.loads(done.stdout)["schema"]) == (ExitCode.CLEAN, "", Comparison.schema)
    synthetic_run(tmp_path / "elsewhere", ["other_task"], episodes=3)
    for second, code in (("nothing", ExitCode.NOT_FOUND), ("foo", ExitCode.USAGE), ("elsewhere", ExitCode.NOT_RUN)):
        done = xpl("compare", "foo", second, folder=tmp_path)
        assert (done.code, done.stdout) == (code, "")
        assert done.stderr.startswith("error: ")


def test_the_documentation_shows_what_the_command_prints(tmp_path: Path) -> None:
    """docs/statistics.md: the pairs of its example, in the text and in its table."""
    pairs = {"lift_cube": PairedCounts(27, 4, 14, 5), "stack_blocks_two": PairedCounts(9, 6, 15, 20)}
    folders = []
    for side, name in enumerate(("Foo", "Bar")):
        folder = synthetic_run(tmp_path / name, list(pairs), ["clean"], 50, policy=name, faults=Faults(retried=0))

        def outcome(line: Line, side: int = side) -> Line:
            both, only_first, only_second, _ = pairs[line["task"]]
            ends = ((0, both + only_first), (both + only_first, both + only_first + only_second))
            won = line["seed"] < both or ends[side][0] <= line["seed"] < ends[side][1]
            return {**line, "success": won, "failure": None if won else "task", "digest": None}

        folders.append(rewritten(folder, lambda lines, outcome=outcome: [*map(outcome, lines)]))
    printed = verdicts.text(compare(*map(records.read, folders))).splitlines()
    page = (ROOT / "docs" / "statistics.md").read_text(encoding="utf-8")
    assert "\n".join(printed[:6]) in page, "\n".join(printed)
    assert printed[-2].removeprefix("- ") in page.replace("\n  ", " ")
