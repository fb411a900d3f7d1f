"""`xpl report`: the files, their content, and refusals; test_pages.py tests the page itself."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import re
import shutil
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.commands import xpl
from tests.support.recordings.runs import Faults, synthetic_run
from tests.support.work import calls
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.report import curves, episodes, media, number_format, report_files
from xpl_cli.evaluation.statistics.summary import summarise
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from pathlib import Path

MUCH = 1 << 30
FILES = {report_files.PAGE, report_files.MARKDOWN, report_files.DOCUMENT, report_files.TABLE, report_files.EPISODES}


def _write(folder: Path, out: Path | None = None, budget: int = MUCH) -> Path:
    out = out or folder / report_files.FOLDER
    report_files.write(records.read(folder), out, budget)
    return out


def _data(page: str) -> Any:
    match = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert match is not None
    return json.loads(match[1])


# --- Files ------------------------------------------------------------------------------------------------------------


def test_a_report_is_a_page_and_the_same_for_machines_and_for_papers(tmp_path: Path) -> None:
    """The command writes five files beside the record and prints the path of the page."""
    run = synthetic_run(tmp_path / "foo", episodes=6)
    done = xpl("report", str(run), folder=tmp_path)
    assert done.code == ExitCode.CLEAN, done.stderr
    assert done.stdout.strip() == str(run / "report" / "index.html")
    assert {path.name for path in (run / "report").iterdir()} == FILES
    document = json.loads((run / "report/report.json").read_text())
    assert validate(document, "report") == []
    assert document["summary"] == summarise(records.read(run)).as_json()
    rows = list(csv.DictReader(io.StringIO((run / "report/episodes.csv").read_text())))
    assert [int(row["index"]) for row in rows] == list(range(24))
    assert sum(row["success"] == "1" for row in rows) == document["summary"]["overall"]["successes"]
    text = (run / "report/report.md").read_text()
    assert "| lift\\_cube | clean |" in text
    assert document["summary"]["notes"][-1].split(":")[0] in text


def test_a_run_that_cannot_be_reported_is_refused_in_a_sentence(tmp_path: Path) -> None:
    nothing = xpl("report", ".", folder=tmp_path)
    assert nothing.code == ExitCode.NOT_FOUND
    assert "no recorded run" in nothing.stderr
    several = xpl("report", "a", "b", "--out", "c", folder=tmp_path)
    assert several.code == ExitCode.USAGE
    assert "takes one run, got 2" in several.stderr


def test_a_report_is_replaced_and_nothing_else_is(tmp_path: Path) -> None:
    """A second report replaces the first; a folder with other files stays as it is."""
    run = synthetic_run(tmp_path / "foo", episodes=2)
    first = (_write(run) / report_files.PAGE).read_bytes()
    assert (_write(run) / report_files.PAGE).read_bytes() == first
    (run / report_files.FOLDER / "mine.txt").write_text("work")
    with pytest.raises(UserError, match=r"holds more than a report \(mine\.txt\)"):
        _write(run)
    assert (run / report_files.FOLDER / "mine.txt").read_text() == "work"


def test_a_run_that_goes_on_is_reported_as_what_it_is(tmp_path: Path) -> None:
    """Page and Markdown give the number of remaining episodes; cells without an episode have no rate."""
    out = _write(synthetic_run(tmp_path / "foo", episodes=10, played=13))
    assert "13 of 40 episodes" in (out / report_files.PAGE).read_text()
    assert "This run is not complete: 13 of 40 episodes." in (out / report_files.MARKDOWN).read_text()
    assert (_write(synthetic_run(tmp_path / "bar", episodes=2, played=0)) / report_files.PAGE).is_file()


@pytest.mark.slow
def test_many_episodes_take_not_much_each(tmp_path: Path) -> None:
    """Reading, statistics, page, tables: 600 calls for an episode are 200 us."""
    run = synthetic_run(tmp_path / "foo", [f"task_{number}" for number in range(10)], episodes=100)
    _write(run)  # what is imported and compiled once does not count
    out, count = calls(lambda: _write(run))
    assert count < 600 * 2000
    assert len(_data((out / report_files.PAGE).read_text())["episodes"]["columns"]["index"]) == 2000


def test_spreadsheets_find_no_formula(tmp_path: Path) -> None:
    """A text that begins like a formula is made a text; numbers below zero stay numbers."""
    table = episodes.as_csv(("a", "b"), [("=1+1", -2.5), ("plain", "@sum")])
    assert list(csv.reader(io.StringIO(table)))[1:] == [["'=1+1", "-2.5"], ["plain", "'@sum"]]


# --- The page as a file -----------------------------------------------------------------------------------------------


def test_the_page_holds_all_that_it_needs(tmp_path: Path) -> None:
    """Nothing in it leads elsewhere, and its own policy lets nothing but its own style and script run."""
    page = (_write(synthetic_run(tmp_path / "foo", episodes=4, traces=2, films=2)) / report_files.PAGE).read_text()
    assert not re.search(r"""(?:src|href|url)\s*[=(]\s*["']?(?:https?:)?//""", page)
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    assert policy is not None
    allowed = policy[1].replace("&#39;", "'")
    assert "default-src 'none'" in allowed
    assert "connect-src 'none'" in allowed
    for element in ("style", "script"):
        inside = re.findall(rf"<{element}>(.*?)</{element}>", page, re.DOTALL)
        assert len(inside) == 1
        digest = base64.b64encode(hashlib.sha256(inside[0].encode()).digest()).decode()
        assert f"{element}-src 'sha256-{digest}'" in allowed


def test_the_list_holds_every_episode(tmp_path: Path) -> None:
    """Columns and shared values restore the record."""
    run = synthetic_run(tmp_path / "foo", episodes=10, faults=Faults(0.2, 0.2, 0.3))
    data = _data((_write(run) / report_files.PAGE).read_text())["episodes"]
    finals = list(records.read(run).finals.values())
    columns, values = data["columns"], data["values"]
    assert [values[index] for index in columns["task"]] == [one.task for one in finals]
    assert [values[index] for index in columns["error"]] == [one.error for one in finals]
    assert [values[index] for index in columns["outcome"]] == [episodes.verdict(one) for one in finals]
    assert {"success", "task", "policy", "infrastructure"} == {values[index] for index in columns["outcome"]}
    assert sum(map(len, data["earlier"].values())) == sum(one.attempt - 1 for one in finals) > 0


# --- Films and curves -------------------------------------------------------------------------------------------------


def test_what_exceeds_the_budget_is_linked(tmp_path: Path) -> None:
    """Without a budget videos are linked, wherever the page is, and curves are named."""
    run = synthetic_run(tmp_path / "a run", episodes=2, traces=3, films=2)
    media_by_index = _data((_write(run, tmp_path / "elsewhere", budget=0) / report_files.PAGE).read_text())["media"]
    assert media_by_index["0"]["film"] == {"source": "../a%20run/films/0.webp", "video": False}
    assert media_by_index["2"] == {"trace": "../a%20run/traces/2.npz"}
    embedded = _data((_write(run) / report_files.PAGE).read_text())["media"]
    assert embedded["0"]["film"]["source"].startswith("data:image/webp;base64,")
    assert len(embedded["2"]["curves"]["panels"]) == 14


def test_a_small_budget_goes_to_every_cell_and_to_failures_first(tmp_path: Path) -> None:
    """Of each cell in turn, a failure and a success in turn, are embedded."""
    run = records.read(synthetic_run(tmp_path / "foo", episodes=8, traces=32, rate=0.5))
    size = max(len(json.dumps(curves.read(path.read_bytes(), path.name))) for path in run.folder.glob("traces/*"))
    media_by_index = media.collect_media(run, 9 * size, "")
    assert sum("trace" in entry for entry in media_by_index.values()) > 10
    chosen = [run.finals[int(index)] for index, entry in media_by_index.items() if "curves" in entry]
    cells = {(one.task, one.setting) for one in chosen}
    assert len(cells) == 4
    assert all({one.success for one in chosen if (one.task, one.setting) == cell} == {True, False} for cell in cells)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda run: (run / "films/0.webp").write_bytes(b"other"), "is not what was recorded: its digest differs"),
        (lambda run: (run / "films/0.webp").unlink(), "cannot be read: No such file"),
    ],
)
def test_a_changed_or_missing_video_is_not_embedded(tmp_path: Path, spoil: Any, message: str) -> None:
    run = synthetic_run(tmp_path / "foo", episodes=2, films=1)
    spoil(run)
    media_by_index = media.collect_media(records.read(run), MUCH, "")
    assert list(media_by_index["0"]) == ["problem"]
    assert message in media_by_index["0"]["problem"]


def test_a_record_leads_to_no_file_outside_its_run(tmp_path: Path) -> None:
    run = synthetic_run(tmp_path / "foo", episodes=2, films=1)
    shutil.copy(run / "films/0.webp", tmp_path / "secret.webp")
    text = (run / records.FILE).read_text()
    (run / records.FILE).write_text(text.replace("films/0.webp", "../secret.webp"))
    assert "outside the run" in media.collect_media(records.read(run), MUCH, "")["0"]["problem"]


def _trace(path: Path, **arrays: Any) -> Path:
    np.savez(path, frequency=25.0, chunk_starts=np.array([0, 16]), state_steps=np.arange(40), **arrays)
    return path


def _values(panel: dict[str, Any], source: str) -> np.ndarray:
    levels = np.frombuffer(base64.b64decode(panel[source]), "<u2")
    values: np.ndarray = panel["low"] + levels / 65535 * (panel["high"] - panel["low"])
    return values


def test_curves_come_back_as_they_were(tmp_path: Path) -> None:
    """Each column has a panel with a title of its own; values are exact to one part in 65,535 of their range."""
    joints, poses = np.random.default_rng(0).normal(size=(2, 40, 7)).astype(np.float32)
    names = {
        "state.left_arm_joint_state": joints,
        "action.left_arm_joint_state": joints + 1,
        "state.left_ee_pose": poses,
    }
    read_curves = curves.read(_trace(tmp_path / "a.npz", **names).read_bytes(), "a.npz")
    assert read_curves["chunks"] == [0, 16]
    titles = [panel["title"] for panel in read_curves["panels"]]
    assert titles == [f"left arm joint {number}" for number in range(1, 8)] + [
        f"left flange {axis}" for axis in ("x", "y", "z", "qw", "qx", "qy", "qz")
    ]
    panel = read_curves["panels"][2]
    tolerance = (panel["high"] - panel["low"]) / 65535
    np.testing.assert_allclose(_values(panel, "state"), joints[:, 2], atol=tolerance)
    np.testing.assert_allclose(_values(panel, "action"), joints[:, 2] + 1, atol=tolerance)


def test_long_curves_are_thinned_and_constant_ones_drawn(tmp_path: Path) -> None:
    """A curve has few enough points to draw; what never moves, or is no number, does no harm."""
    still, bad = np.ones((5000, 1), np.float32), np.full((5000, 1), np.nan, np.float32)
    path = _trace(tmp_path / "a.npz", **{"action.ee_joint_state": still, "action.arm_joint_state": bad})
    read_curves = curves.read(path.read_bytes(), path.name)
    assert len(read_curves["at"]["action"]) <= curves.MOST_POINTS
    assert read_curves["at"]["action"][1] == 9
    assert [(panel["title"], panel["low"], panel["high"]) for panel in read_curves["panels"]] == [
        ("arm joint", 0.0, 0.0),
        ("gripper", 1.0, 1.0),
    ]


def test_what_is_no_trace_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "pickled.npz", frequency=np.array({"a": 1}, dtype=object))
    (tmp_path / "text.npz").write_text("no archive")
    for name in ("pickled.npz", "text.npz"):
        with pytest.raises(UserError, match="holds no curves"):
            curves.read((tmp_path / name).read_bytes(), name)


@pytest.mark.parametrize(
    ("seconds", "expected"), [(0.4, "0 s"), (59, "59 s"), (125, "2 min 5 s"), (7500, "2 h 5 min"), (90_000, "1 d 1 h")]
)
def test_times_are_for_people(seconds: float, expected: str) -> None:
    """Two units at most."""
    assert number_format.duration(seconds) == expected


def test_differences_have_a_sign_and_no_negative_zero() -> None:
    assert [number_format.points(value) for value in (0.123, -0.051, -0.001)] == ["+12", "\N{MINUS SIGN}5", "+0"]
