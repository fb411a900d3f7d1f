"""Records that a stranger wrote: a bad line is named by its number, and refused or left out, whatever it holds."""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support.commands import problem, xpl
from tests.support.examples import examples
from tests.support.recordings.runs import Faults, rewritten, synthetic_run
from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.leaderboard import comparable_runs, ranking, ranking_text
from xpl_cli.evaluation.records import lines, records
from xpl_cli.evaluation.records.failures import contradiction
from xpl_cli.evaluation.records.records import RecordError
from xpl_cli.evaluation.report import curves, media, report_files
from xpl_cli.standard import spec
from xpl_cli.standard.validate import validate

BAD = 4
"""Number of the line that is made bad, counted from 1: an episode's, with others after it."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run of 8 episodes, all of which were played."""
    return synthetic_run(tmp_path_factory.mktemp("sound") / "run", episodes=2)


def _lines(folder: Path) -> list[bytes]:
    return (folder / records.FILE).read_bytes().splitlines()


def _changed(source: Path, target: Path, line: bytes | dict[str, Any], number: int = BAD) -> Path:
    """Return a copy of a run in which one line is another one."""
    found = _lines(source)
    found[number - 1] = line if isinstance(line, bytes) else json.dumps(line).encode()
    target.mkdir(exist_ok=True)
    (target / records.FILE).write_bytes(b"".join(one + b"\n" for one in found))
    return target


def _set(path: str, value: Any) -> Callable[[dict[str, Any]], Any]:
    """Return what puts a value at a place such as `inference.count`."""

    def change(line: dict[str, Any]) -> None:
        *way, last = path.split(".")
        for name in way:
            line = line[name]
        line[last] = value

    return change


def _nested(levels: int) -> Any:
    value: Any = 0
    for _ in range(levels):
        value = [value]
    return value


NAN, INFINITY = float("nan"), float("inf")
COUNTS: list[Any] = [-1, 1.5, 1.0, True, "1", None, []]
NAMES: list[Any] = ["", None, 1, [], {}, "\ud800", "other"]
WRONG: dict[str, list[Any]] = {
    **dict.fromkeys(("index", "attempt", "seed", "steps"), COUNTS),
    **dict.fromkeys(("task", "setting"), NAMES),
    "score": [-0.1, 1.1, "0.5", True, [], {}, NAN, INFINITY, -INFINITY],
    "wall_seconds": [-1, "1", None, NAN, INFINITY, 1e308],
    "success": [1, 0, "true", [], ""],
    "failure": ["", "other", True, 0, [], {}],
    "final": [1, 0, None, "true"],
    "machine": ["", "x" * 64, "A" * 64, None, 1],
    "kind": ["", "run", "other", None, 1, [], {}, "episode\0"],
    "started": ["", "yesterday", "2026-13-45T99:99:99Z", 1, None],
    "corrections": [[], {"a": -1}, {"a": 1.0}, {"a": None}, "x"],
    "inference.count": [-1, 1.0, "1", None],
    "inference.histogram": [{}, [-1], [1.0], [None], "x"],
    "layout": [[], "x", {"a": NAN}, {"a": INFINITY}, {"\ud800": 1}, {"a": "\udfff"}, {"a": _nested(70)}, _nested(500)],
    "stages": [[], {"a": 1}, {"a": None}],
    "trace": ["x", {}, {"path": 1, "digest": "0" * 64}, {"path": "a", "digest": "0"}],
    "embodiment": ["two words"],
    "action_type": ["torque"],
    "more": [1],
    "error": [None],
    "safety": [[]],
}


@pytest.mark.parametrize("name", WRONG)
def test_a_value_that_cannot_be_is_refused_by_line_and_left_out_by_request(
    name: str, sound: Path, tmp_path: Path
) -> None:
    """Types, ranges, words, other keys: all that the schema says, and numbers and texts that are none."""
    for value in WRONG[name]:
        line = json.loads(_lines(sound)[BAD - 1])
        _set(name, value)(line)
        run = _changed(sound, tmp_path / "run", line)
        with pytest.raises(RecordError, match=f"line {BAD}"):
            records.read(run)
        found = records.read(run, skip=True)
        assert len(found.skipped) == 1
        assert f"line {BAD}" in found.skipped[0]
        assert len(found.attempts) == len(_lines(sound)) - 3


@pytest.mark.parametrize("number", [2, BAD])
def test_a_key_that_is_missing_is_refused(number: int, sound: Path, tmp_path: Path) -> None:
    """Each key that the schema requires, of machines and episodes."""
    line = json.loads(_lines(sound)[number - 1])
    for key in spec.schema("record")["$defs"][line["kind"]]["required"]:
        run = _changed(sound, tmp_path / "run", {one: line[one] for one in line if one != key}, number)
        with pytest.raises(RecordError, match=f"line {number}"):
            records.read(run)


RAW = {
    "nothing": b"",
    "a number": b"1",
    "a list": b"[]",
    "null": b"null",
    "half a line": b'{"kind": "episode"',
    "two lines in one": b"{}{}",
    "not UTF-8": b'{"kind": "\xff\xfe"}',
    "a surrogate in UTF-8": b'{"kind": "\xed\xa0\x80"}',
    "UTF-16": '{"kind": "episode"}'.encode("utf-16"),
    "zeros": bytes(100),
    "an integer of 4,300 digits and more": b'{"kind": "episode", "index": ' + b"9" * 5000 + b"}",
    "a number beyond all floats": b'{"kind": "machine", "machine": "' + b"0" * 64 + b'", "facts": {"a": 1e999}}',
    "a hundred thousand brackets": b"[" * 100_000 + b"]" * 100_000,
    "a hundred thousand maps": b'{"kind":' * 100_000,
    "a line of five million bytes": b'{"kind": "' + b"x" * 5_000_000 + b'"}',
    "a key twice": b'{"kind": "episode", "success": false, "success": true}',
    "a key twice, once with escapes": b'{"kind": "episode", "success": false, "s\\u0075ccess": true}',
    "a key of a thousand brackets": b'{"kind": "episode", "a": ' + b"[" * 1000 + b"]" * 1000 + b"}",
}


@pytest.mark.parametrize("name", RAW)
def test_bytes_that_are_no_line_are_refused_wherever_they_stand(name: str, sound: Path, tmp_path: Path) -> None:
    """As the first line, in the middle and at the end, where only what is no JSON at all counts as torn."""
    run = _changed(sound, tmp_path / "run", RAW[name])
    with pytest.raises(RecordError, match=f"line {BAD}"):
        records.read(run)
    assert f"line {BAD}" in records.read(run, skip=True).skipped[0]
    with pytest.raises(RecordError, match="line 1"):
        records.read(_changed(sound, tmp_path / "run", RAW[name], 1), skip=True)
    last = _changed(sound, tmp_path / "run", RAW[name], len(_lines(sound)))
    try:
        lines.parse_line(RAW[name])
    except lines.LineNotJsonError:
        assert records.read(last).torn
    except lines.LineError:
        with pytest.raises(RecordError, match=f"line {len(_lines(sound))}"):
            records.read(last)


Lines = list[dict[str, Any]]


def _again(lines: Lines, *first: dict[str, Any]) -> Lines:
    """Return the lines with attempts before the last episode's, which is played again after them."""
    last = lines[-1]
    attempts = [{**last, "attempt": number, "final": False, **told} for number, told in enumerate(first, 1)]
    return [*lines[:-1], *attempts, {**last, "attempt": len(first) + 1}]


ERRORED = {"success": None, "score": None, "failure": "infrastructure", "end_reason": "infrastructure", "error": "x"}
FAILED = {"success": False, "failure": "task", "end_reason": "max_steps"}
DIED = {"success": False, "failure": "policy", "end_reason": "policy_died", "error": "x"}
AGAINST: dict[str, tuple[Callable[[Lines], Lines], str]] = {
    "success and a failed task": (
        lambda lines: [*lines[:-1], {**lines[-1], "success": True, "failure": "task"}],
        'success: expected false with failure "task", got true',
    ),
    "success and lost infrastructure": (
        lambda lines: [*lines[:-1], {**lines[-1], **ERRORED, "success": True}],
        'success: expected null with failure "infrastructure", got true',
    ),
    "no success and no failure": (
        lambda lines: [*lines[:-1], {**lines[-1], "success": False, "failure": None}],
        "success: expected true or null with failure null, got false",
    ),
    "a third attempt alone": (
        lambda lines: [*lines[:-1], {**lines[-1], "attempt": 3}],
        "attempt: expected 1 for episode 7, at most 3, got 3",
    ),
    "more attempts than the plan allows": (
        lambda lines: _again(lines, ERRORED, ERRORED, ERRORED),
        "attempt: expected 4 for episode 7, at most 3, got 4",
    ),
    "an honest failure played again": (
        lambda lines: _again(lines, FAILED),
        "final: expected true: this attempt at episode 7 may not be retried",
    ),
    "a failed task that says that a process died": (
        lambda lines: _again(lines, {**DIED, "failure": "task"}),
        "final: expected true: this attempt at episode 7 may not be retried",
    ),
}


@pytest.mark.parametrize("name", AGAINST)
def test_lines_that_contradict_each_other_or_their_plan_are_refused(name: str, tmp_path: Path) -> None:
    """An episode is retried only after an infrastructure error or crash, as often as the plan allows, and ends once."""
    change, said = AGAINST[name]
    run = rewritten(synthetic_run(tmp_path / "run", episodes=2, faults=Faults(retried=0)), change)
    with pytest.raises(RecordError, match=re.escape(said)):
        records.read(run)
    assert said in records.read(run, skip=True).skipped[0]


@pytest.mark.parametrize("line", [ERRORED, DIED])
def test_an_episode_that_failed_otherwise_than_the_task_may_be_retried(line: dict[str, Any], tmp_path: Path) -> None:
    """Twice, as the plan says."""
    run = rewritten(
        synthetic_run(tmp_path / "run", episodes=2, faults=Faults(retried=0)), lambda lines: _again(lines, line, line)
    )
    assert records.read(run).finals[7].attempt == 3


def test_a_plan_with_a_cell_twice_is_refused(tmp_path: Path) -> None:
    """Its episodes would count twice."""
    run = synthetic_run(tmp_path / "run", ("a",), ("clean",), episodes=2)
    cell = json.loads(_lines(run)[0])["cells"][0]
    rewritten(run, cells=[cell, {**cell, "seeds": [7]}])
    with pytest.raises(RecordError, match="line 1: cells: expected each task once in each setting"):
        records.read(run)


@pytest.mark.parametrize("told", [{"steps": 0}, {"inference": {"count": 0, "seconds": 0.0}}])
def test_success_without_a_step_or_a_request_is_not_ranked(told: dict[str, Any], tmp_path: Path) -> None:
    """Whoever did nothing cannot have succeeded; an environment may say so, but no ranking."""
    run = synthetic_run(tmp_path / "run", rate=1.0, faults=Faults(policy=0, retried=0))
    found = records.read(rewritten(run, lambda lines: [{**lines[0], **told}, *lines[1:]]))
    with pytest.raises(UserError, match=r"episode 0 succeeded, (after 0 steps|without a request)"):
        comparable_runs.gather([found])


@pytest.mark.parametrize("kind", ["a pipe", "a device", "a folder", "a loop of links", "no rights", "too large"])
def test_what_is_no_file_is_refused_and_nothing_waits(kind: str, tmp_path: Path) -> None:
    """`xpl report` of a pipe that nobody writes to, and of whatever else can bear the name."""
    run = tmp_path / "run"
    run.mkdir()
    file = run / records.FILE
    if kind == "a pipe":
        os.mkfifo(file)
    elif kind == "a folder":
        file.mkdir()
    elif kind == "no rights":
        if os.geteuid() == 0:
            pytest.skip("nothing is forbidden to root")
        file.touch(0)
    elif kind == "too large":
        with file.open("wb") as stream:
            stream.truncate(1 << 40)
    else:
        file.symlink_to(file if kind == "a loop of links" else "/dev/zero")
    for command in (["report"], ["leaderboard"], ["compare", str(run)]):
        ended = xpl(*command, run)
        assert problem(ended, (4,)) is None, ended
        assert "error: " in ended.stderr


def test_every_command_that_reads_records_names_the_line(sound: Path, tmp_path: Path) -> None:
    """All of them refuse the run; `report`, `compare` and `leaderboard` leave the line out if they are told to."""
    line = json.loads(_lines(sound)[BAD - 1]) | {"score": -1}
    run = _changed(sound, tmp_path / "run", line)
    reading: tuple[list[str | Path], ...] = (["report", run], ["compare", run, sound], ["leaderboard", run, sound])
    others: tuple[list[str | Path], ...] = (
        ["submit", "--check", "demo_policy", run],
        ["eval", "demo_policy", "--env", "mujoco", "--resume", "--out", run],
    )
    for command in (*reading, *others):
        ended = xpl(*command, folder=tmp_path)
        assert problem(ended, (4,)) is None, (command, ended)
        assert f"line {BAD}" in ended.stderr
        assert "--skip-bad-lines" in ended.stderr
    for command in reading:
        ended = xpl(*command, "--skip-bad-lines", *(["--anyway"] if command[0] == "leaderboard" else []))
        assert ended.code == 0, ended
        assert f"line {BAD}" in ended.stderr
    assert "left out of the record" in (run / "report" / report_files.MARKDOWN).read_text(encoding="utf-8")


def _npy(shape: tuple[int, ...] = (), dtype: str = "<f4", data: bytes = bytes(4)) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"shape": shape, "fortran_order": False, "descr": dtype})
    return stream.getvalue() + data


def _trace(**arrays: bytes) -> bytes:
    """Return the bytes of a trace, some arrays of which are other bytes."""
    usual = {
        "frequency": _npy(),
        "chunk_starts": _npy((1,), "<i4"),
        "state_steps": _npy((1,), "<i4"),
        "state.a": _npy((1, 1)),
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in (usual | arrays).items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


TRACES: dict[str, Callable[[], tuple[bytes, str]]] = {
    "inflates to 64 MB": lambda: (_trace(**{"state.a": bytes(64 << 20)}), "it would unpack to 67.1 MB, more than"),
    "claims 28 TB": lambda: (_trace(**{"state.a": _npy((7 * 10**12, 1))}), "its header says float32"),
    "claims less than nothing": lambda: (_trace(**{"state.a": _npy((-1, -1))}), "unknown dimension"),
    "numbers without a size": lambda: (_trace(**{"state.a": _npy((10**12, 1), "|S0", b"")}), "itemsize"),
    "objects": lambda: (_trace(**{"state.a": _npy((1, 1), "|O", bytes(8))}), "its header says object"),
    "texts": lambda: (_trace(**{"state.a": _npy((1, 1), "<U1")}), "expected numbers in 2 dimensions"),
    "a curve without columns": lambda: (_trace(**{"state.a": _npy((1,))}), "expected numbers in 2 dimensions"),
    "a million curves": lambda: (
        _trace(**{"state.a": _npy((1, 10**6), data=bytes(4 * 10**6))}),
        "more than 2000 curves",
    ),
    "no frequency to draw by": lambda: (_trace(frequency=_npy(data=b"\0\0\xc0\x7f")), "expected a finite number"),
    "chunks between steps": lambda: (_trace(chunk_starts=_npy((1,))), "expected numbers in 1 dimensions"),
    "half a header": lambda: (_trace(frequency=b"\x93NUMPY\1\0"), "header"),
    "a header of code": lambda: (_trace(frequency=b"\x93NUMPY\1\0\x10\0__import__('os')"), "malformed"),
    "damage": lambda: (_trace()[:60] + bytes(8) + _trace()[68:], ""),
}


@pytest.mark.parametrize("name", TRACES)
def test_a_trace_beyond_its_bounds_is_a_sentence_of_the_page(name: str, sound: Path, tmp_path: Path) -> None:
    """Nothing is made of a header before what it says is there, and a page of the run is written nevertheless."""
    content, said = TRACES[name]()
    line = json.loads(_lines(sound)[BAD - 1])
    line["trace"] = {"path": "a.npz", "digest": hashlib.sha256(content).hexdigest()}
    run = _changed(sound, tmp_path / "run", line)
    (run / "a.npz").write_bytes(content)
    (entry,) = media.collect_media(records.read(run), 1 << 24, "").values()
    assert "a.npz holds no curves: " in entry["problem"]
    assert said in entry["problem"]


def test_numbers_as_large_as_may_be_are_drawn(tmp_path: Path) -> None:
    """Their range is beyond all floats."""
    most = np.array([-1e308, 1e308, 0.0])
    found = curves.read(_trace(**{"state.a": _npy((3, 1), "<f8", most.tobytes())}), "a")
    assert json.dumps(found, allow_nan=False)


STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")
HOSTILE = (
    "\0",
    "\x1b[31m\x1b]0;x\x07",
    "<script>alert(1)</script>",
    "=cmd|' /C calc'!A0",
    "a\r\nforged",
    "\u202eabc",
    "|`*_[x](y)",
)


@pytest.mark.parametrize("name", HOSTILE, ids=[repr(name) for name in HOSTILE])
def test_names_of_any_kind_break_neither_reports_nor_boards(name: str, tmp_path: Path) -> None:
    """What the schema allows as the name of a task or setting can be shown in every form."""
    told: dict[str, Any] = {"tasks": (f"t{name}", name), "settings": (f"s{name}",), "episodes": 2, "policy": name}
    run, other = synthetic_run(tmp_path / "run", **told), synthetic_run(tmp_path / "other", **told, seed=1)
    commands: tuple[list[str | Path], ...] = (
        ["report", run],
        ["compare", run, other],
        ["leaderboard", run, other, "--out", tmp_path / "board"],
    )
    for command in commands:
        for more in ([], ["--json"]):
            ended = xpl(*command, *more)
            assert ended.code == 0, ended
            assert "\x1b" not in ended.stdout
            assert "\0" not in ended.stdout
            assert not any(line.startswith("forged") for line in ended.stdout.splitlines())
    for page in (*(run / "report").iterdir(), *(tmp_path / "board").iterdir()):
        text = page.read_text(encoding="utf-8")
        assert STEERING.search(text) is None, page
        if page.suffix in {".html", ".md"}:
            assert "<script>alert(1)" not in text, page


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=examples(120), suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_whatever_stands_in_a_line_is_left_out_or_can_be_reported(
    data: st.DataObject, sound: Path, tmp_path: Path
) -> None:
    """Values of any kind at any place of any line: what is read of it is valid, and makes a report and a ranking.

    Only a record that contradicts itself is not ranked.
    """
    number = data.draw(st.integers(2, len(_lines(sound))))
    line = json.loads(_lines(sound)[number - 1])
    line[data.draw(st.sampled_from(sorted(line)) | st.text(max_size=6))] = data.draw(values)
    run = _changed(sound, tmp_path / "run", line, number)
    found = records.read(run, skip=True)
    assert all(f"line {number}" in skipped for skipped in found.skipped)
    assert all(validate(one.as_json(), lines.definition("episode")) == [] for one in found.attempts)
    document = report_files.write(found, run / "report", 0)
    json.dumps(document, allow_nan=False, ensure_ascii=False).encode()
    if any(map(contradiction, found.finals.values())):
        with pytest.raises(UserError, match="the record was changed"):
            comparable_runs.gather([found], anyway=True)
        return
    ranked = ranking.rank(comparable_runs.gather([found], anyway=True))
    for form in (ranking_text.text, ranking_text.as_csv, ranking_text.as_markdown):
        assert form(ranked)


def test_the_compiled_schema_says_what_the_other_validator_says(sound: Path) -> None:
    """Two validators of one schema agree on every line above, and the fast one knows every kind of line."""
    assert set(lines.KINDS) == {reference["$ref"].rpartition("/")[2] for reference in spec.schema("record")["oneOf"]}
    # The other one has no opinion on times, and neither of them on what is no JSON.
    tried = [(name, value) for name, found in WRONG.items() if name not in ("kind", "started") for value in found]
    for name, value in tried:
        line = json.loads(_lines(sound)[BAD - 1])
        _set(name, value)(line)
        try:
            raw = json.dumps(line, allow_nan=False, ensure_ascii=False).encode()
        except ValueError:
            continue
        if "[" * 70 not in raw.decode():
            assert _is_line(raw) != bool(validate(line, lines.definition("episode"))), (name, value)


def _is_line(raw: bytes) -> bool:
    try:
        lines.parse_line(raw)
    except lines.LineError:
        return False
    return True
