"""Bundles: equal content gives equal bytes, unpacking is strict, and claims are checked against records."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.recordings.runs import Faults, episode, synthetic_run
from xpl_cli.audit.rules.model import TargetReport
from xpl_cli.audit.rules.verdict import verdict_of
from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.records import records
from xpl_cli.standard.validate import validate
from xpl_cli.submission import archive, bundle, claims, consistency, prepare, replay
from xpl_cli.submission.replay import ReplayMatch, ReplayPair, ReplayVerdict

if TYPE_CHECKING:
    from xpl_cli.evaluation.records.records import Run

    Line = dict[str, Any]

LIMIT = 10**7


def _run(folder: Path, **changes: Any) -> Run:
    return records.read(synthetic_run(folder, episodes=10, **changes))


def _rewritten(run: Run, change: Callable[[list[Line]], Any]) -> Run:
    """Return a run whose lines were edited."""
    file = run.folder / records.FILE
    lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    change(lines)
    file.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")
    return records.read(file)


def _episodes(lines: list[Line]) -> list[Line]:
    return [line for line in lines if line["kind"] == "episode"]


class TestArchive:
    def test_equal_content_gives_equal_bytes(self, tmp_path: Path) -> None:
        """Neither the order of files nor the time nor their modes matter."""
        first, second, source = tmp_path / "a.zip", tmp_path / "b.zip", tmp_path / "source"
        source.write_bytes(b"content")
        source.chmod(0o700)
        files: dict[str, Path | bytes] = {"b/c": b"1", "a": source}
        archive.write(first, files)
        source.chmod(0o600)
        assert archive.write(second, dict(reversed(files.items()))) == archive.write(first, files)
        assert first.read_bytes() == second.read_bytes()
        assert sorted(archive.unpack(first, tmp_path / "out", limit=LIMIT)) == ["a", "b/c"]
        assert (tmp_path / "out/b/c").read_bytes() == b"1"

    def test_nothing_is_left_where_writing_fails(self, tmp_path: Path) -> None:
        with pytest.raises(UserError, match="cannot be written"):
            archive.write(tmp_path / "a.zip", {"a": tmp_path / "missing"})
        assert not list(tmp_path.iterdir())


def _copied(line: Line) -> Line:
    """Return an episode without the fields that its index in the plan determines."""
    return {key: value for key, value in line.items() if key not in {"index", "attempt", "seed"}}


def _told(line: Line) -> Line:
    """Return the digest of the states of an episode."""
    return {"digest": line["digest"]}


def _of_one_trace(lines: list[Line]) -> None:
    for line in lines[-2:]:
        line["trace"] = {"path": "traces/38.npz", "digest": "0" * 64}


class TestConsistency:
    @pytest.fixture
    def run(self, tmp_path: Path) -> Run:
        """Return a run with retries and failures of the policy."""
        return _run(tmp_path / "run", faults=Faults(policy=0.2, retried=0.3))

    def test_a_sound_run_has_no_problem(self, run: Run) -> None:
        assert list(consistency.problems(run)) == []

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda lines: lines[-1].update(success=None, failure=None), "have neither success nor failure"),
            (lambda lines: lines[-1].update(embodiment="piper"), "but its plan says 'arx_x5'"),
            (lambda lines: lines[-1].update(machine="0" * 64), "names a machine"),
            (lambda lines: lines[1]["facts"].update(python="3.12.0"), "does not have the facts"),
            (lambda lines: lines[-1].update(success=None, failure="infrastructure"), "ended after 1 attempts"),
            (lambda lines: lines[-1].update(wall_seconds=0.0), "waiting for the policy"),
            (lambda lines: lines[-1]["inference"].update(histogram=[1]), "histogram"),
            (
                lambda lines: lines[-1].update(containment="trusted"),
                "in 1 of its 40 episodes the system could not isolate",
            ),
            (lambda lines: lines[-1].pop("containment"), "in 1 of its 40 episodes the record does not say"),
            (lambda lines: lines[-1].update(_copied(lines[-2])), "has the states of episode 38: it was copied"),
            (lambda lines: lines[-1].update(_told(lines[-2])), "39 has the states of episode 38: it was copied"),
            (_of_one_trace, "episode 39 has traces/38.npz of episode 38: it was copied"),
            (lambda lines: lines.pop(), "1 of its episodes were not run"),
        ],
    )
    def test_edited_lines_are_found(self, run: Run, change: Callable[[list[Line]], Any], message: str) -> None:
        problems = list(consistency.problems(_rewritten(run, change)))
        assert any(message in problem for problem in problems), problems

    def test_an_incomplete_line_is_reported(self, run: Run) -> None:
        with (run.folder / records.FILE).open("a", encoding="utf-8") as stream:
            stream.write('{"kind": "epi')
        assert any("incomplete" in problem for problem in consistency.problems(records.read(run.folder)))


class TestClaims:
    def test_the_manifest_is_valid_and_repeats_itself(self, tmp_path: Path) -> None:
        """It has counts by task and setting, and neither times nor paths."""
        run = _run(tmp_path / "run")
        policy = prepare.describe_adapter(run)
        audit = verdict_of(TargetReport("policy/Foo", "Foo", "policy")).as_json()
        entries = {"audit.json": bundle.BundledFile.of(b"{}")}
        manifest = bundle.BundleManifest(policy, [claims.claim_of(run)], entries, audit).as_json()
        assert validate(manifest, "submission") == []
        assert sum(cell["completed"] for cell in manifest["runs"][0]["cells"]) == len(run.finals)
        assert str(tmp_path) not in bundle.document(manifest).decode()

    def test_an_environment_is_a_name_and_no_path(self, tmp_path: Path) -> None:
        """A path might lead into the bundle itself, to an environment in which everything succeeds."""
        run = _run(tmp_path / "run")
        environment = replace(run.plan.environment, name="unpacked/envs/easy")
        with pytest.raises(UserError, match="expected the name of a package"):
            claims.environment_folder(replace(run, plan=replace(run.plan, environment=environment)))


def _pair(recorded: bool | None, replayed: bool | None, *, digests: str = "ab", equal: bool = False) -> ReplayPair:
    """Return an episode that was run twice; `digests` has one letter for each time."""
    old, new = (
        episode(success=won, digest=name, end_reason="max_steps")
        for won, name in zip((recorded, replayed), digests, strict=True)
    )
    return ReplayPair(old, new, is_equal_machine=equal)


def _errored(pair: ReplayPair) -> ReplayPair:
    replayed = replace(pair.replayed, failure="infrastructure", success=None)
    return ReplayPair(pair.recorded, replayed, is_equal_machine=False)


WON, LOST, FLIPPED = (_pair(*outcomes) for outcomes in ((True, True), (False, False), (True, False)))
SAME, OTHER = _pair(True, True, digests="aa", equal=True), _pair(True, True, equal=True)


class TestJudgement:
    @pytest.mark.parametrize(
        ("pairs", "total", "deterministic", "verdict"),
        [
            ([SAME] * 5, 100, True, ReplayVerdict.AGREES),
            ([SAME, OTHER], 100, True, ReplayVerdict.DISAGREES),
            ([WON, LOST], 100, True, ReplayVerdict.AGREES),
            ([OTHER] * 2, 100, False, ReplayVerdict.AGREES),
            ([FLIPPED] * 6 + [WON] * 4, 100, True, ReplayVerdict.DISAGREES),
            ([FLIPPED] + [WON] * 4, 100, True, ReplayVerdict.UNDECIDED),
            ([FLIPPED, _pair(False, True)] * 2 + [WON, LOST] * 98, 1000, True, ReplayVerdict.AGREES),
            ([_errored(WON)], 10, True, ReplayVerdict.UNDECIDED),
            ([_errored(WON), WON], 10, True, ReplayVerdict.AGREES),
        ],
        ids=[
            "the same states",
            "other states on an equal machine",
            "other states elsewhere, where outcomes count",
            "other states of a policy that draws random numbers",
            "a rate that was made up",
            "few differences, which chance can explain",
            "rates that are surely close",
            "nothing but infrastructure errors",
            "an infrastructure error among others",
        ],
    )
    def test_a_sample_is_judged_by_what_may_be_asked_of_machine_and_policy(
        self, pairs: list[ReplayPair], total: int, deterministic: bool, verdict: ReplayVerdict
    ) -> None:
        assert replay.judge(pairs, total, deterministic=deterministic).verdict is verdict

    def test_figures_say_how_many_others_may_come_out_otherwise(self) -> None:
        result = replay.judge([SAME] * 5, 100, deterministic=True)
        assert (result.counts, result.change) == ({ReplayMatch.SAME: 5}, pytest.approx((-0.43, 0.43), abs=0.01))
        assert result.differing is not None
        assert 0.4 < result.differing.high < 0.6
        assert replay.judge([WON] * 3, 3, deterministic=True).differing == (0.0, 0.0)  # who plays all knows the share
        result = replay.judge([_errored(WON), WON], 10, deterministic=True)
        assert result.counts == {ReplayMatch.INFRASTRUCTURE_ERROR: 1, ReplayMatch.OUTCOME: 1}

    def test_the_sample_is_drawn_from_what_counts(self, tmp_path: Path) -> None:
        """Infrastructure errors are left out; the same seed draws the same sample."""
        run = _run(tmp_path / "run", faults=Faults(infrastructure=0.3))
        drawn = replay.draw([run], 1000, 7)
        assert [index for _, index in drawn] == replay.eligible(run)
        assert all(run.finals[index].failure != "infrastructure" for _, index in drawn)
        assert len(drawn) < len(run.finals)
        few = replay.draw([run], 5, 7)
        assert few == replay.draw([run], 5, 7)
        assert few != replay.draw([run], 5, 8)
