"""Bundles: packed alike, opened with suspicion, and held against their records."""

from __future__ import annotations

import json
import stat
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.recordings.runs import Faults, episode, synthetic
from xpl_cli.audit.rules.model import TargetReport
from xpl_cli.audit.rules.verdict import judged
from xpl_cli.basics.errors import NotFoundError, UserError
from xpl_cli.evaluation.records import records
from xpl_cli.standard.validate import validate
from xpl_cli.submission import archive, bundle, claims, consistency, prepare, replay
from xpl_cli.submission.replay import Match, Pair, Verdict

if TYPE_CHECKING:
    from xpl_cli.evaluation.records.records import Run

    Line = dict[str, Any]

LIMIT = 10**7


def _run(folder: Path, **changes: Any) -> Run:
    return records.read(synthetic(folder, episodes=10, **changes))


def _rewritten(run: Run, change: Callable[[list[Line]], Any]) -> Run:
    """Return a run whose lines somebody has edited."""
    file = run.folder / records.FILE
    lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    change(lines)
    file.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")
    return records.read(file)


def _episodes(lines: list[Line]) -> list[Line]:
    return [line for line in lines if line["kind"] == "episode"]


class TestArchive:
    """A bundle is one file, equal for equal content, and harmless to open."""

    def test_equal_content_gives_equal_bytes(self, tmp_path: Path) -> None:
        """Neither the order of files nor the time nor their modes show."""
        first, second, source = tmp_path / "a.zip", tmp_path / "b.zip", tmp_path / "source"
        source.write_bytes(b"content")
        source.chmod(0o700)
        files: dict[str, Path | bytes] = {"b/c": b"1", "a": source}
        archive.write(first, files)
        source.chmod(0o600)
        assert archive.write(second, dict(reversed(files.items()))) == archive.write(first, files)
        assert first.read_bytes() == second.read_bytes()

    def test_what_is_packed_comes_out(self, tmp_path: Path) -> None:
        """Unpacking returns the digest of every file."""
        path = tmp_path / "a.zip"
        archive.write(path, {"b/c": b"1", "a": b"2"})
        digests = archive.unpack(path, tmp_path / "out", limit=LIMIT)
        assert sorted(digests) == ["a", "b/c"]
        assert (tmp_path / "out/b/c").read_bytes() == b"1"

    def test_nothing_is_left_where_writing_fails(self, tmp_path: Path) -> None:
        """A bundle is there whole, or not at all."""
        with pytest.raises(UserError, match="cannot be written"):
            archive.write(tmp_path / "a.zip", {"a": tmp_path / "missing"})
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize("name", ["../a", "/a", "a/../b", "a//b", "a\\b", "c:a", "a\nb", "", "."])
    def test_names_that_lead_elsewhere_are_refused(self, tmp_path: Path, name: str) -> None:
        """A bundle stays inside of the folder that it is unpacked into."""
        path = tmp_path / "a.zip"
        with zipfile.ZipFile(path, "w") as made:
            made.writestr(zipfile.ZipInfo(name), b"1")
        with pytest.raises(UserError, match="expected files with plain names"):
            archive.unpack(path, tmp_path / "out", limit=LIMIT)

    def test_links_are_refused(self, tmp_path: Path) -> None:
        """A link may lead anywhere."""
        path, entry = tmp_path / "a.zip", zipfile.ZipInfo("a")
        entry.external_attr = (stat.S_IFLNK | 0o777) << 16
        with zipfile.ZipFile(path, "w") as made:
            made.writestr(entry, b"/etc/passwd")
        with pytest.raises(UserError, match="expected files with plain names"):
            archive.unpack(path, tmp_path / "out", limit=LIMIT)

    @pytest.mark.filterwarnings("ignore:Duplicate name")
    def test_a_name_comes_once(self, tmp_path: Path) -> None:
        """Of two files with one name nobody knows which one counts."""
        path = tmp_path / "a.zip"
        with zipfile.ZipFile(path, "w") as made:
            made.writestr("a", b"1")
            made.writestr("a", b"2")
        with pytest.raises(UserError, match="each once"):
            archive.unpack(path, tmp_path / "out", limit=LIMIT)

    def test_what_would_fill_the_disk_is_refused(self, tmp_path: Path) -> None:
        """The limit holds before anything is written."""
        path = tmp_path / "a.zip"
        archive.write(path, {"a": bytes(LIMIT + 1)})
        with pytest.raises(UserError, match="more than the limit"):
            archive.unpack(path, tmp_path / "out", limit=LIMIT)
        assert not (tmp_path / "out").exists()

    def test_damage_is_said(self, tmp_path: Path) -> None:
        """Bytes that changed on the way are found; what is no archive is none."""
        path = tmp_path / "a.zip"
        archive.write(path, {"a": bytes(range(256)) * 4})
        content = bytearray(path.read_bytes())
        content[60] ^= 1
        path.write_bytes(content)
        with pytest.raises(UserError, match="damaged"):
            archive.unpack(path, tmp_path / "out", limit=LIMIT)
        path.write_bytes(b"nothing")
        with pytest.raises(UserError, match="no bundle"):
            archive.unpack(path, tmp_path / "again", limit=LIMIT)
        with pytest.raises(NotFoundError):
            archive.unpack(tmp_path / "b.zip", tmp_path / "again", limit=LIMIT)


class TestConsistency:
    """Records are held against their schema, their plan and themselves."""

    @pytest.fixture
    def run(self, tmp_path: Path) -> Run:
        """Return a run with retries and failures of the policy."""
        return _run(tmp_path / "run", faults=Faults(policy=0.2, retried=0.3))

    def test_a_sound_run_has_no_problem(self, run: Run) -> None:
        """What was recorded is in order, retries and all."""
        assert list(consistency.problems(run)) == []

    @pytest.mark.parametrize(
        ("change", "said"),
        [
            (lambda lines: lines[-1].update(success=True, failure="task"), "has success true with failure"),
            (lambda lines: lines[-1].update(success=None, failure=None), "neither succeeded nor failed"),
            (lambda lines: lines[-1].update(embodiment="piper"), "but its plan says 'arx_x5'"),
            (lambda lines: lines[-1].update(machine="0" * 64), "names a machine"),
            (lambda lines: lines[1]["facts"].update(python="3.12.0"), "does not have the facts"),
            (lambda lines: lines[-1].update(attempt=4), "has the attempts 4"),
            (lambda lines: lines[-1].update(success=None, failure="infrastructure"), "was given up after 1 attempts"),
            (lambda lines: lines[-1].update(wall_seconds=0.0), "waiting for the policy"),
            (lambda lines: lines[-1]["inference"].update(histogram=[1]), "histogram"),
            (lambda lines: lines.pop(), "1 of its episodes were not played"),
        ],
    )
    def test_edited_lines_are_found(self, run: Run, change: Callable[[list[Line]], Any], said: str) -> None:
        """A line that does not fit the others is named."""
        found = list(consistency.problems(_rewritten(run, change)))
        assert any(said in problem for problem in found), found

    def test_an_episode_is_played_again_only_where_it_was_spoilt(self, run: Run) -> None:
        """Whoever plays until it succeeds is found out."""

        def play_again(lines: list[Line]) -> None:
            first = dict(lines[-1], final=False, success=False, failure="task")
            lines[-1].update(attempt=2)
            lines.insert(len(lines) - 1, first)

        found = list(consistency.problems(_rewritten(run, play_again)))
        assert any("although the infrastructure had not spoilt it" in problem for problem in found), found

    def test_a_torn_line_is_said(self, run: Run) -> None:
        """A run that crashed is to be finished first."""
        with (run.folder / records.FILE).open("a", encoding="utf-8") as stream:
            stream.write('{"kind": "epi')
        assert any("torn" in problem for problem in consistency.problems(records.read(run.folder)))


class TestClaims:
    """What a bundle claims follows from its records."""

    def test_the_manifest_is_valid_and_repeats_itself(self, tmp_path: Path) -> None:
        """It tells counts by task and setting, and neither times nor places."""
        run = _run(tmp_path / "run")
        policy = prepare.described(run)
        audit = judged(TargetReport("policy/Foo", "Foo", "policy")).as_json()
        entries = {"audit.json": bundle.Entry.of(b"{}")}
        manifest = bundle.Manifest(policy, [claims.claim(run)], entries, audit).as_json()
        assert validate(manifest, "submission") == []
        assert sum(cell["played"] for cell in manifest["runs"][0]["cells"]) == len(run.finals)
        assert str(tmp_path) not in bundle.document(manifest).decode()

    def test_an_environment_is_a_name_and_no_path(self, tmp_path: Path) -> None:
        """A path might lead into the bundle itself, to an environment in which everything succeeds."""
        run = _run(tmp_path / "run")
        environment = replace(run.plan.environment, name="unpacked/envs/easy")
        with pytest.raises(UserError, match="expected the name of a package"):
            claims.environment(replace(run, plan=replace(run.plan, environment=environment)))


def _pair(recorded: bool | None, replayed: bool | None, *, digests: str = "ab", equal: bool = False) -> Pair:
    """Return an episode that was played twice; `digests` has one letter for each time."""
    old, new = (
        episode(success=won, digest=name, end_reason="max_steps")
        for won, name in zip((recorded, replayed), digests, strict=True)
    )
    return Pair(old, new, is_equal_machine=equal)


def _spoilt(pair: Pair) -> Pair:
    replayed = replace(pair.replayed, failure="infrastructure", success=None)
    return Pair(pair.recorded, replayed, is_equal_machine=False)


class TestJudgement:
    """What a sample says depends on what may be asked of the machine and the policy."""

    def test_the_same_states_agree(self) -> None:
        """Everything repeats itself: the record is right as far as the sample goes."""
        found = replay.judge([_pair(True, True, digests="aa", equal=True)] * 5, 100, deterministic=True)
        assert found.verdict is Verdict.AGREES
        assert found.counts == {Match.SAME: 5}
        assert found.differing is not None
        assert 0.4 < found.differing.high < 0.6

    def test_other_states_on_an_equal_machine_disagree(self) -> None:
        """A deterministic policy has to do the same thing again, whatever the outcome."""
        pairs = [_pair(True, True, digests="aa", equal=True), _pair(True, True, digests="ab", equal=True)]
        found = replay.judge(pairs, 100, deterministic=True)
        assert found.verdict is Verdict.DISAGREES
        assert "1 of 2" in found.sentence

    @pytest.mark.parametrize(("equal", "deterministic"), [(False, True), (True, False)])
    def test_elsewhere_outcomes_count(self, equal: bool, deterministic: bool) -> None:
        """On another machine, or with a policy that draws random numbers, states may differ."""
        pairs = [_pair(True, True, equal=equal), _pair(False, False, equal=equal)]
        assert replay.judge(pairs, 100, deterministic=deterministic).verdict is Verdict.AGREES

    def test_a_rate_that_was_made_up_disagrees(self) -> None:
        """Recorded successes that fail here, and none the other way, are more than chance."""
        found = replay.judge([_pair(True, False)] * 6 + [_pair(True, True)] * 4, 100, deterministic=True)
        assert found.verdict is Verdict.DISAGREES
        assert found.change is not None
        assert found.change.high < 0

    def test_few_differences_are_undecided(self) -> None:
        """What chance can explain, and what a larger sample would tell, is not green."""
        found = replay.judge([_pair(True, False)] + [_pair(True, True)] * 4, 100, deterministic=True)
        assert found.verdict is Verdict.UNDECIDED

    def test_rates_that_are_surely_close_agree(self) -> None:
        """Single episodes that come out otherwise on another machine do not matter if the rate is the same."""
        both_ways = [_pair(True, False), _pair(False, True)] * 2
        found = replay.judge(
            both_ways + [_pair(True, True)] * 98 + [_pair(False, False)] * 98, 1000, deterministic=True
        )
        assert found.verdict is Verdict.AGREES
        assert found.change is not None
        assert max(-found.change.low, found.change.high) <= replay.MARGIN

    def test_all_episodes_leave_nothing_to_chance(self) -> None:
        """Who plays everything knows the share."""
        found = replay.judge([_pair(True, True)] * 3, 3, deterministic=True)
        assert found.differing == (0.0, 0.0)

    def test_spoilt_episodes_say_nothing(self) -> None:
        """Where the infrastructure spoils all of it, nothing is known."""
        pair = _pair(True, True)
        assert replay.judge([_spoilt(pair)], 10, deterministic=True).verdict is Verdict.UNDECIDED
        found = replay.judge([_spoilt(pair), pair], 10, deterministic=True)
        assert found.verdict is Verdict.AGREES
        assert found.counts == {Match.SPOILT: 1, Match.OUTCOME: 1}

    def test_the_sample_is_drawn_from_what_counts(self, tmp_path: Path) -> None:
        """Spoilt episodes are left out; the same seed draws the same ones."""
        run = _run(tmp_path / "run", faults=Faults(infrastructure=0.3))
        drawn = replay.draw([run], 1000, 7)
        assert [index for _, index in drawn] == replay.eligible(run)
        assert all(run.finals[index].failure != "infrastructure" for _, index in drawn)
        assert len(drawn) < len(run.finals)
        few = replay.draw([run], 5, 7)
        assert few == replay.draw([run], 5, 7)
        assert few != replay.draw([run], 5, 8)
