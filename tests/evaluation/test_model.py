"""The classes of records and answers hold what their schemas declare, key by key; records are written as read."""

from __future__ import annotations

import json
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.recordings.runs import episode, synthetic_run
from xpl_cli.evaluation.leaderboard import ranking
from xpl_cli.evaluation.records import lines, model, records
from xpl_cli.evaluation.statistics import comparison_model, summary_model
from xpl_cli.standard import spec
from xpl_cli.standard.validate import validate
from xpl_cli.submission import bundle, claims

if TYPE_CHECKING:
    from pathlib import Path

_RECORD = spec.schema("record")["$defs"]
_PLAN = _RECORD["run"]["properties"]
_SUBMISSION = spec.schema("submission")
_SUMMARY, _COMPARISON, _LEADERBOARD = map(spec.schema, ("summary", "comparison", "leaderboard"))
_EXECUTION = _SUMMARY["properties"]["execution"]
_ANSWER = {"schema", "next"}


@pytest.mark.parametrize(
    ("kind", "schema", "apart"),
    [
        (model.RunPlan, _RECORD["run"], {"kind", "schema"}),
        (model.PlannedPolicy, _PLAN["policy"], set()),
        (model.LoadedCheckpoint, _PLAN["policy"]["properties"]["checkpoint"], set()),
        (model.PlannedEnvironment, _PLAN["environment"], set()),
        (model.Control, _PLAN["control"], set()),
        (model.PlannedCell, _PLAN["cells"]["items"], set()),
        (model.EpisodeRecord, _RECORD["episode"], {"kind"}),
        (model.Inference, _RECORD["episode"]["properties"]["inference"], set()),
        (model.RecordedFile, _RECORD["file"], set()),
        (bundle.BundleManifest, _SUBMISSION, {"schema", "tool"}),
        (bundle.BundledAdapter, _SUBMISSION["properties"]["policy"], set()),
        (bundle.BundledFile, _SUBMISSION["properties"]["files"]["additionalProperties"], set()),
        (bundle.BundledCheckpoints, _SUBMISSION["$defs"]["checkpoints"], set()),
        (claims.RunClaim, _SUBMISSION["properties"]["runs"]["items"], set()),
        (claims.CellClaim, _SUBMISSION["$defs"]["cell"], set()),
        (summary_model.Summary, _SUMMARY, _ANSWER),
        (summary_model.SummaryRow, _SUMMARY["$defs"]["row"], set()),
        (summary_model.Contrast, _SUMMARY["properties"]["contrasts"]["items"], set()),
        (summary_model.ExecutionStats, _EXECUTION, set()),
        (summary_model.Latency, _EXECUTION["properties"]["inference"], set()),
        (summary_model.ErrorCount, _EXECUTION["properties"]["errors"]["items"], set()),
        (comparison_model.Comparison, _COMPARISON, _ANSWER),
        (comparison_model.ComparedRun, _COMPARISON["$defs"]["side"], set()),
        (comparison_model.ComparisonRow, _COMPARISON["$defs"]["row"], set()),
        (ranking.Ranking, _LEADERBOARD, _ANSWER),
        (ranking.RankingRow, _LEADERBOARD["$defs"]["row"], set()),
        (ranking.FieldDifference, _LEADERBOARD["properties"]["differences"]["items"], set()),
    ],
)
def test_fields_are_those_of_the_schema(kind: type, schema: dict[str, Any], apart: set[str]) -> None:
    """What the schema lets be missing may be missing in the class."""
    fields_by_name = {item.name: item for item in fields(kind)}
    assert set(fields_by_name) == set(schema["properties"]) - apart
    optional = set(fields_by_name) - set(schema["required"])
    assert not [name for name in optional if fields_by_name[name].default is MISSING]


def test_a_record_is_written_as_it_was_read(tmp_path: Path) -> None:
    """Line by line, but for keys that may be null and were left out."""
    folder = synthetic_run(tmp_path, episodes=30, traces=2, films=1)
    raw = [json.loads(line) for line in (folder / records.FILE).read_text().splitlines()]
    run = records.read(folder)
    assert run.plan.as_json() == raw[0]
    for attempt, line in zip(run.attempts, raw[2:], strict=True):
        written = attempt.as_json()
        assert {key: value for key, value in written.items() if value is not None or key in line} == line
        assert validate(written, lines.definition("episode")) == []


def test_what_may_be_null_is_always_written() -> None:
    """A reader need not check whether there is an instruction, a layout or a digest."""
    properties = _RECORD["episode"]["properties"]
    line = episode().as_json()
    nullable = {name for name, entry in properties.items() if "null" in entry.get("type", ()) or "anyOf" in entry}
    assert nullable | {"failure"} <= line.keys()
    assert {"steps", "stages", "error", "trace"}.isdisjoint(line)
    assert validate(line, lines.definition("episode")) == []
