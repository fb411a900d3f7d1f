"""The cache of the static gate: what did not change is not read again, and nothing else is believed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support import forked
from tests.support.adapters.rules import Room, made_adapter, made_room
from xpl_cli.audit.engine import cache, engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome
from xpl_cli.audit.rules.options import AuditOptions


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """A scaffold that imports a module of a subfolder."""
    folder = made_adapter(tmp_path / "Foo")
    (folder / "tools").mkdir()
    (folder / "tools/maths.py").write_text("VALUE = 1\n")
    (folder / "tools/unread.py").write_text("VALUE = 1\n")
    with (folder / "model.py").open("a") as model:
        model.write("\n\nfrom .tools.maths import VALUE\n")
    return folder


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    """A file to which rules of a test write their names when they run."""
    return tmp_path / "trace"


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trace: Path) -> Room:
    """Three rules: one passes, one finds something, one does not apply."""
    cache._version.cache_clear()
    made = made_room(tmp_path / "room", monkeypatch)
    made.rule("passes", ran("passes", trace), code="XPL101")
    made.rule("finds", ran("finds", trace) + "yield Finding('wrong')", code="XPL102")
    made.rule("asks", ran("asks", trace), code="XPL103", facts="source, options")
    return made


def ran(name: str, trace: Path) -> str:
    """Return the beginning of a rule that says that it runs, and reads all files of the boundary."""
    return (
        f"with open({str(trace)!r}, 'a') as trace: trace.write('{name} ')\n"
        "for name in source.text_files: source.text(name)\nyield from ()\n"
    )


def audit(adapter: Path, folder: Path | None) -> GateReport:
    """Run the static gate."""
    return engine.audit(adapter, "policy", AuditOptions(gates=(Gate.STATIC,), cache=folder)).gates[0]


def again(adapter: Path, tmp_path: Path, trace: Path) -> list[str]:
    """Audit with the cache of the test and return which rules ran."""
    cache._version.cache_clear()
    trace.write_text("")
    audit(adapter, tmp_path / "cache")
    return trace.read_text().split()


def test_only_passes_that_follow_from_the_files_are_kept(
    room: Room, adapter: Path, tmp_path: Path, trace: Path
) -> None:
    """Findings are found anew; so is what depends on options."""
    assert again(adapter, tmp_path, trace) == ["passes", "finds", "asks"]
    assert again(adapter, tmp_path, trace) == ["finds", "asks"]


def test_a_report_is_the_same_with_and_without_the_cache(adapter: Path, tmp_path: Path) -> None:
    """With the rules of the project: results, digest, and finish line; what does not apply is kept with its reason."""
    fresh = audit(adapter, None)
    for _ in range(2):
        kept = audit(adapter, tmp_path / "cache")
        assert (kept.results, kept.finish) == (fresh.results, fresh.finish)
    (record,) = (tmp_path / "cache").iterdir()
    codes = json.loads(record.read_text())["passes"].keys()
    assert len(codes) > 30
    inapplicable = {result.code for result in fresh.results if result.outcome is Outcome.NOT_APPLICABLE}
    assert inapplicable - codes == {"XPL501"}  # it judges the audit, and not the files alone


CHANGES: dict[str, Callable[[Path], object]] = {
    "a file": lambda folder: (folder / "deploy.yml").write_text((folder / "deploy.yml").read_text() + "# more\n"),
    "its mode": lambda folder: (folder / "eval.sh").chmod(0o600),
    "a deeper file that is read": lambda folder: (folder / "tools/maths.py").write_text("VALUE = 2\n"),
    "a new file": lambda folder: (folder / "notes.txt").write_text(""),
    "a new deeper name": lambda folder: (folder / "tools/new.py").write_text(""),
    "a removed file": lambda folder: (folder / "README.md").unlink(),
    "a link": lambda folder: (folder / "weights").symlink_to(folder.parent),
    "what takes a file's place": lambda folder: ((folder / "README.md").unlink(), (folder / "README.md").mkdir()),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("change", CHANGES)
def test_any_change_that_a_rule_could_see_makes_it_run(
    room: Room, adapter: Path, tmp_path: Path, trace: Path, change: str
) -> None:
    again(adapter, tmp_path, trace)
    CHANGES[change](adapter)
    assert "passes" in again(adapter, tmp_path, trace)
    assert "passes" not in again(adapter, tmp_path, trace)


def test_files_that_no_rule_reads_may_change(room: Room, adapter: Path, tmp_path: Path, trace: Path) -> None:
    again(adapter, tmp_path, trace)
    (adapter / "tools/unread.py").write_text("VALUE = 3\n")
    os.utime(adapter / "model.py", (0, 0))
    assert "passes" not in again(adapter, tmp_path, trace)


def test_another_name_is_another_package(room: Room, adapter: Path, tmp_path: Path, trace: Path) -> None:
    again(adapter, tmp_path, trace)
    assert "passes" in again(adapter.rename(tmp_path / "Bar"), tmp_path, trace)


def test_a_changed_rule_runs_again_and_others_do_not(room: Room, adapter: Path, tmp_path: Path, trace: Path) -> None:
    room.rule("second", ran("second", trace), code="XPL104")
    again(adapter, tmp_path, trace)
    room.rule("passes", ran("passes", trace) + "# more", code="XPL101")
    assert again(adapter, tmp_path, trace) == ["passes", "finds", "asks"]


def test_a_rule_that_is_gone_leaves_nothing(room: Room, adapter: Path, tmp_path: Path, trace: Path) -> None:
    gone = room.rule("second", ran("second", trace), code="XPL104")
    again(adapter, tmp_path, trace)
    gone.unlink()
    room.rule("passes", ran("passes", trace) + "# more", code="XPL101")
    again(adapter, tmp_path, trace)
    (record,) = (tmp_path / "cache").iterdir()
    assert list(json.loads(record.read_text())["passes"]) == ["XPL101"]


def test_what_rules_are_built_on_is_part_of_their_version(
    room: Room, adapter: Path, tmp_path: Path, trace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another release, or an edit in the engine or the standard."""
    again(adapter, tmp_path, trace)
    monkeypatch.setattr(cache, "tool_digest", lambda: "another")
    assert "passes" in again(adapter, tmp_path, trace)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b'{"format": 1}', b'{"format": 1, "files": {}, "passes": {"XPL101": 3}}']
)
def test_a_broken_record_counts_as_none(room: Room, adapter: Path, tmp_path: Path, trace: Path, content: bytes) -> None:
    again(adapter, tmp_path, trace)
    (record,) = (tmp_path / "cache").iterdir()
    record.write_bytes(content)
    assert "passes" in again(adapter, tmp_path, trace)
    assert "passes" not in again(adapter, tmp_path, trace)


def test_a_cache_that_cannot_be_written_changes_nothing(room: Room, adapter: Path, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("")
    assert audit(adapter, tmp_path / "cache").finish == audit(adapter, None).finish


def test_a_package_that_changes_while_it_is_audited_is_not_kept(room: Room, adapter: Path, tmp_path: Path) -> None:
    """What was read may be neither the old state nor the new one."""
    file = str(adapter / "README.md")
    room.rule("passes", f"with open({file!r}, 'a') as readme: readme.write('more')\nyield from ()", code="XPL101")
    audit(adapter, tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


def test_records_that_were_not_used_for_long_are_removed(tmp_path: Path) -> None:
    for number in range(12):
        (tmp_path / f"{number}.json").write_text("{}")
        os.utime(tmp_path / f"{number}.json", (number, number))
    cache._prune(tmp_path, limit=12)
    assert len(list(tmp_path.iterdir())) == 12
    cache._prune(tmp_path, limit=10)
    assert sorted(int(path.stem) for path in tmp_path.iterdir()) == list(range(4, 12))


def test_a_folder_of_very_many_names_is_not_looked_through(
    room: Room, adapter: Path, tmp_path: Path, trace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, "_MOST_NAMES", 3)
    for _ in range(2):
        assert again(adapter, tmp_path, trace) == ["passes", "finds", "asks"]


@pytest.mark.slow
def test_runs_at_the_same_time_leave_a_whole_record(adapter: Path, tmp_path: Path) -> None:
    """Several processes audit one adapter with an empty cache; each is right, and the next one is served by it."""
    command = [sys.executable, "-m", "xpl_cli", "audit", str(adapter), "--gate", "static", "--json"]
    surroundings = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "home")}
    runs = [
        subprocess.Popen(command, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) for _ in range(4)
    ]
    reports = [json.loads(run.communicate()[0]) for run in runs]
    assert len({report["targets"][0]["gates"][0]["finish"] for report in reports}) == 1
    (record,) = (tmp_path / "home/xpl/audit").iterdir()
    assert len(json.loads(record.read_text())["passes"]) > 30


def test_the_cache_lies_where_the_user_keeps_caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("XPL_CACHE", str(tmp_path / "own"))
    assert cache.default_folder() == tmp_path / "own/audit"
    monkeypatch.setenv("XPL_CACHE", "relative")
    assert cache.default_folder() == tmp_path / "xpl/audit"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache.default_folder() == tmp_path / ".cache/xpl/audit"


def test_no_cache_neither_reads_nor_writes(adapter: Path, tmp_path: Path) -> None:
    surroundings = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "home")}
    forked.run("audit", adapter, "--gate", "static", "--no-cache", env=surroundings)
    assert not (tmp_path / "home").exists()


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_a_record_that_is_no_file_counts_as_none(adapter: Path, room: Room, tmp_path: Path, kind: str) -> None:
    """Nothing waits for a writer, and the audit says what it says without a cache."""
    kept = tmp_path / "kept"
    before = audit(adapter, kept)
    (record,) = kept.iterdir()
    record.unlink()
    {"pipe": os.mkfifo, "device": lambda path: path.symlink_to("/dev/zero"), "folder": os.mkdir}[kind](record)
    after = audit(adapter, kept)
    assert [result.outcome for result in after.results] == [result.outcome for result in before.results]


def test_a_record_that_names_what_is_no_file_counts_as_none(adapter: Path, room: Room, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    audit(adapter, kept)
    (record,) = kept.iterdir()
    told = json.loads(record.read_text())
    record.write_text(json.dumps({**told, "files": {"/dev/zero": "0"}}))
    assert audit(adapter, kept).results
