"""Bundles of real runs: findings of verification, and replays."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.support import forked
from tests.support.checkout import ROOT
from tests.support.recordings.bundles import recorded
from tests.support.recordings.runs import renamed
from xpl_cli.audit.engine.engine import audit
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.progress import Progress
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.records.fingerprints import LoadedCheckpoint
from xpl_cli.evaluation.rollout.config import Runtime
from xpl_cli.evaluation.runs import evaluate
from xpl_cli.evaluation.runs.plan import PlanRequest
from xpl_cli.lifecycle.checkpoints import fetch, specification
from xpl_cli.packages import package
from xpl_cli.standard.validate import validate
from xpl_cli.submission import archive, bundle, claims, inspection, prepare, replay, unproven, verify
from xpl_cli.submission.replay_runner import ReplayRunner

if TYPE_CHECKING:
    from xpl_cli.audit.rules.model import TargetReport
    from xpl_cli.evaluation.records.records import Run

    Line = dict[str, Any]

EXPERT = ROOT / "policy" / "scripted_expert"
UNAUDITED = "the audit ran without the gates offline, mujoco"
"""What is wrong with the bundles of these tests, which spare the time of a whole audit."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run of two episodes of the expert that were never run."""
    return recorded(tmp_path_factory.mktemp("recorded") / "expert")


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run of two episodes that the expert has solved."""
    wishes = PlanRequest("lift_cube", "clean", 2, 0, horizon=5)
    out = tmp_path_factory.mktemp("runs") / "expert"
    return evaluate.evaluate(evaluate.EvalRequest(package.load(EXPERT), "mujoco", out, wishes, films=0))


@pytest.fixture(scope="module")
def report() -> TargetReport:
    """Return the report of the static gate on the expert."""
    return audit(EXPERT, package.POLICY, AuditOptions(gates=(Gate.STATIC,)), display_path="policy/scripted_expert")


@pytest.fixture(scope="module")
def packed(run: Run, report: TargetReport, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the run's bundle."""
    path = tmp_path_factory.mktemp("bundles") / "expert.xpl.zip"
    prepare.pack(prepare.SubmitRequest(package.load(EXPERT), (run.folder,), path), [run], report)
    return path


def _forged(source: Path, target: Path, change: Callable[[Path], Any], *, consistently: bool = True) -> Path:
    """Write a bundle with changed files, with or without changing its manifest."""
    folder = target.with_suffix("")
    names = sorted(archive.unpack(source, folder, limit=10**8))
    change(folder)
    manifest = json.loads((folder / bundle.MANIFEST).read_bytes())
    if consistently:
        for name, entry in manifest["files"].items():
            content = (folder / name).read_bytes()
            entry.update(sha256=hashlib.sha256(content).hexdigest(), size=len(content))
    files: dict[str, Path | bytes] = {name: folder / name for name in names}
    archive.write(target, {**files, bundle.MANIFEST: bundle.document(manifest)})
    return target


def _records(change: Callable[[list[Line]], Any]) -> Callable[[Path], None]:
    """Return what changes the lines of a bundle's only run."""

    def edit(folder: Path) -> None:
        (file,) = folder.glob(f"runs/*/{records.FILE}")
        lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        change(lines)
        file.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")

    return edit


def _problems(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the problems of a bundle by check, but for the audit that these tests leave out."""
    report = verify.verify(verify.VerifyRequest(path, sample=0))
    assert validate(report.as_json(), "verification") == []
    problems_by_check = {check.name: check.problems for check in report.checks if check.problems}
    if problems_by_check.get("audit") == (UNAUDITED,):
        del problems_by_check["audit"]
    return problems_by_check


def test_a_bundle_repeats_itself(run: Run, report: TargetReport, packed: Path, tmp_path: Path) -> None:
    """The same run, files and audit give the same bytes, which name no place of this machine."""
    again = tmp_path / "again.zip"
    prepare.pack(prepare.SubmitRequest(package.load(EXPERT), (run.folder,), again), [run], report)
    assert again.read_bytes() == packed.read_bytes()
    names = archive.unpack(again, tmp_path / "out", limit=10**8)
    paths = (str(EXPERT.parent.parent), str(run.folder), sys.prefix)
    texts = [(tmp_path / "out" / name).read_text(encoding="utf-8") for name in names]
    assert not [path for path in paths for text in texts if path in text]


def test_a_sound_bundle_lacks_only_what_was_left_out(packed: Path) -> None:
    """Everything but the audit, of which two gates did not run here, is in order."""
    assert _problems(packed) == {}
    report = verify.verify(verify.VerifyRequest(packed, sample=0))
    assert str(report.verdict).startswith("PARTIAL static only: nothing wrong")


def test_a_bundle_of_fewer_than_all_evaluation_seeds_is_named_a_subset(packed: Path) -> None:
    """A board counts all of them; the others may be those that went wrong."""
    inspected = inspection.inspect(bundle.open_bundle(packed, packed.parent / "opened", limit=10**8), Progress())[1]
    coverage = inspection.seed_coverage(inspected)
    assert coverage is not None
    assert [vars(part) for part in coverage] == [{"task": "lift_cube", "setting": "clean", "seeds": 2, "of": 100}]
    whole = [replace(part, seeds=100) for part in coverage]
    reports = [verify.VerificationReport("", "", (), (), parts=parts) for parts in (coverage, whole, None)]
    assert ["subset" in " ".join(unproven.sentences(report)) for report in reports] == [True, False, False]


@pytest.mark.slow
def test_curves_come_along_where_they_are_wanted(played: Run, report: TargetReport, tmp_path: Path) -> None:
    """They are checked against the records, whose digests they must have."""
    path = tmp_path / "traced.zip"
    prepare.pack(
        prepare.SubmitRequest(package.load(EXPERT), (played.folder,), path, frozenset({"trace"})), [played], report
    )
    assert _problems(path) == {}
    forged = _forged(path, tmp_path / "forged.zip", lambda folder: next(folder.rglob("0.npz")).write_bytes(b""))
    assert "is not what episode 0 recorded" in _problems(forged)["curves and films"][0]


@pytest.mark.parametrize(
    ("change", "where", "message"),
    [
        (lambda folder: (folder / "policy/scripted_expert/model.py").write_text(""), "files", "has the SHA-256"),
        (lambda folder: (folder / "audit.json").write_text("{}"), "files", "audit.json"),
    ],
)
def test_changed_files_are_found(
    packed: Path, tmp_path: Path, change: Callable[[Path], Any], where: str, message: str
) -> None:
    """A changed file under an unchanged manifest is found; nothing else is checked then."""
    problems = _problems(_forged(packed, tmp_path / "forged.zip", change, consistently=False))
    assert list(problems) == [where]
    assert any(message in problem for problem in problems[where])


@pytest.mark.parametrize(
    "name",
    [
        "policy/scripted_expert/checkpoints/a.bin",
        "policy/scripted_expert/__pycache__/model.cpython-311.pyc",
        "policy/scripted_expert/.git/config",
        "policy/other/model.py",
        "envs/mujoco/environment.py",
        "runs/0/traces/0.npz",
    ],
)
def test_files_that_no_digest_of_the_adapter_covers_are_found(packed: Path, tmp_path: Path, name: str) -> None:
    """The manifest names them, and nothing that was recorded does: the replay might find them."""
    folder = tmp_path / "forged"
    names = archive.unpack(packed, folder, limit=10**8)
    manifest = json.loads((folder / bundle.MANIFEST).read_bytes())
    manifest["files"][name] = vars(bundle.BundledFile.of(b"x"))
    files: dict[str, Path | bytes] = {one: folder / one for one in names}
    archive.write(tmp_path / "a.zip", {**files, name: b"x", bundle.MANIFEST: bundle.document(manifest)})
    assert _problems(tmp_path / "a.zip")["adapter"] == (
        f"{name}: neither the adapter's own files nor the records account for it",
    )


def test_a_run_that_is_named_a_thousand_times_is_read_not_once(packed: Path, tmp_path: Path) -> None:
    change = _documents(lambda manifest: manifest.update(runs=manifest["runs"] * 1000), bundle.MANIFEST)
    problems = _problems(_forged(packed, tmp_path / "forged.zip", change))
    assert problems == {"files": ("submission.json names a folder of a run twice",)}


def _seeds(first: int, second: int, *, frozen: bool = True) -> Callable[[Path], None]:
    """Return what gives the two episodes other seeds, in the plan too."""

    def change(lines: list[Line]) -> None:
        lines[0]["cells"][0].update(seeds=[first, second], frozen=frozen)
        lines[0].update(renamed(lines[0]))
        for line, seed in zip(lines[-2:], (first, second), strict=True):
            line["seed"] = seed

    return _records(change)


def _documents(change: Callable[..., Any], *names: str) -> Callable[[Path], None]:
    """Return what changes some documents of a bundle together."""

    def edit(folder: Path) -> None:
        documents = [json.loads((folder / name).read_bytes()) for name in names]
        change(*documents)
        for name, document in zip(names, documents, strict=True):
            (folder / name).write_bytes(bundle.document(document))

    return edit


def _audited(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    """Return what changes the static gate in a bundle's audit report."""
    return _documents(lambda told: change(told["targets"][0]["gates"][0]), bundle.AUDIT)


def _claimed(**changes: Any) -> Callable[[Path], None]:
    """Return what changes the verdict in a bundle, in its manifest and in its audit report alike."""

    def change(manifest: dict[str, Any], report: dict[str, Any]) -> None:
        manifest["audit"].update(changes)
        report["targets"][0].update(changes)

    return _documents(change, bundle.MANIFEST, bundle.AUDIT)


PARITY = [{"word": "parity", "numbers": {"pairs": 24, "assumed": 0}}]
_NOWHERE = dict.fromkeys(("path", "line", "column", "end_line", "end_column", "expected", "got", "evidence", "fix"))
_FINDING = {**_NOWHERE, "message": "x", "explain": "xpl explain XPL101", "fingerprint": "0" * 16}
_OTHER_WEIGHTS = {"loaded": "0" * 64, "name": None, "declared": []}


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    ("change", "where", "message"),
    [
        (_records(lambda lines: lines[-1].update(success=False, failure="task")), "claims", "has other counts"),
        (_records(lambda lines: lines[-1].update(end_reason="max_steps")), "records", "but ended with max_steps"),
        (_records(lambda lines: lines[-1].update(score=0.0)), "records", "with a score of 0"),
        (_records(lambda lines: lines.pop()), "records", "were not run"),
        (_records(lambda lines: lines[-1].update(steps=201)), "plan", "201 steps: lift_cube ends after 200"),
        (_seeds(1, 2), "plan", "the seeds of lift_cube (clean) are not those"),
        (_seeds(1, 2, frozen=False), "plan", "are not those that mujoco"),
        (_seeds(100_000, 100_001, frozen=False), "plan", "mujoco has frozen"),
        (_seeds(100_000, 100_007), "plan", "the seeds of lift_cube (clean) were chosen"),
        (_seeds(100_007, 100_003), "plan", "were chosen: expected evaluation seeds"),
        (lambda folder: (folder / "policy/scripted_expert/moves.py").write_text(""), "adapter", "have the digest"),
        (_documents(lambda told: told.update(_OTHER_WEIGHTS), bundle.CHECKPOINTS), "checkpoint", "loaded another"),
        (_audited(lambda gate: gate["results"][0].update(outcome="fail")), "audit", "make it red (XPL101 fail)"),
        (_audited(lambda gate: gate["results"][0].update(outcome="not_run")), "audit", "incomplete (XPL101 not_run)"),
        (_audited(lambda gate: gate["results"][0].update(severity="should", findings=[_FINDING])), "audit", "1 fail"),
        (_audited(lambda gate: gate["results"].pop(0)), "audit", "static gate is without the rules XPL101"),
        (_audited(lambda gate: gate["results"].append(gate["results"][0])), "audit", "two results of XPL101"),
        (_audited(lambda gate: gate.update(digest="0" * 16)), "audit", "is not of the adapter in the bundle"),
        (_claimed(verdict="green"), "audit", "claims green, but its rules and the adapter give partial"),
        (_claimed(proven=PARITY), "audit", "claims other proofs: its rules"),
        (_claimed(statement="GREEN"), "audit", "claims another statement"),
        (
            _documents(lambda told: told["audit"].update(proven=PARITY), bundle.MANIFEST),
            "audit",
            "submission.json claims other proofs than audit.json",
        ),
    ],
)
def test_parts_that_contradict_each_other_are_found(
    packed: Path, tmp_path: Path, change: Callable[[Path], Any], where: str, message: str
) -> None:
    """A manifest that was changed along with a file does not help: claims follow from rules and records."""
    problems = _problems(_forged(packed, tmp_path / "forged.zip", change))
    assert any(message in problem for problem in problems[where]), problems


def test_a_run_is_not_packed_twice(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "twice.zip"
    answer = prepare.submit(prepare.SubmitRequest(package.load(EXPERT), (run.folder, run.folder), out))
    assert answer.code == ExitCode.FINDINGS
    assert any("named twice" in problem for problem in answer.problems)
    assert not out.exists()


def test_an_adapter_that_changed_since_is_not_packed(run: Run, tmp_path: Path) -> None:
    changed = tmp_path / "scripted_expert"
    shutil.copytree(EXPERT, changed, ignore=shutil.ignore_patterns("__pycache__"))
    (changed / "model.py").write_text("# other\n", encoding="utf-8")
    answer = prepare.submit(prepare.SubmitRequest(package.load(changed), (run.folder,), tmp_path / "a.zip"))
    assert [problem for problem in answer.problems if "ran with other files" in problem]


class TestReplay:
    """Replays of a run's episodes."""

    @pytest.mark.slow
    def test_states_repeat_bit_by_bit(self, played: Run) -> None:
        """A deterministic policy in a simulation repeats itself on the same machine."""
        pairs = ReplayRunner(EXPERT).replay(played, [0, 1])
        assert [pair.match for pair in pairs] == [replay.ReplayMatch.SAME] * 2
        assert replay.judge(pairs, 2, deterministic=True).verdict is replay.ReplayVerdict.AGREES
        # What nobody played has other states, and is found in the first episode that is played.
        forged = [
            replay.ReplayPair(replace(pair.recorded, digest="0" * 64), pair.replayed, pair.is_equal_machine)
            for pair in pairs
        ]
        assert replay.judge(forged, 2, deterministic=True).verdict is replay.ReplayVerdict.DISAGREES

    @pytest.mark.slow
    def test_an_adapter_that_is_isolated_plays_alike(self, played: Run) -> None:
        """Neither its server nor its loop sees the judging process, and states repeat bit by bit."""
        player = ReplayRunner(EXPERT, runtime=Runtime(isolate=True))
        try:
            rollout_config, server_config = player._configs(played)
        except UserError as error:
            pytest.skip(str(error))
        assert rollout_config.bounds.isolate
        assert server_config.bounds.flags[0] == "--isolate"
        assert [pair.match for pair in player.replay(played, [0])] == [replay.ReplayMatch.SAME]

    def test_only_the_adapter_of_the_run_is_replayed(self, run: Run) -> None:
        with pytest.raises(UserError, match="does not have the files of the run"):
            ReplayRunner(EXPERT.parent / "demo_policy").replay(run, [0])

    def test_weights_that_are_not_here_are_named(self, run: Run) -> None:
        """Without the checkpoint of the run nothing is run, and the error has a hint."""
        policy = replace(run.plan.policy, checkpoint=LoadedCheckpoint("checkpoints/base", "0" * 64))
        other = replace(run, plan=replace(run.plan, policy=policy))
        with pytest.raises(UserError, match="checkpoints/base") as raised:
            ReplayRunner(EXPERT).replay(other, [0])
        assert raised.value.code == ExitCode.NOT_RUN
        assert "xpl checkpoint fetch" in str(raised.value.hint)

    def test_a_robot_is_not_moved(self, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """An environment that does not wait is nothing that could repeat itself."""
        robot = tmp_path / "envs" / "mujoco"
        shutil.copytree(EXPERT.parent.parent / "envs" / "mujoco", robot, ignore=shutil.ignore_patterns("__pycache__"))
        text = (robot / "env.yml").read_text(encoding="utf-8")
        (robot / "env.yml").write_text(text.replace("real_time: false", "real_time: true"), encoding="utf-8")
        monkeypatch.setattr(claims, "environment_folder", lambda _: robot)
        with pytest.raises(UserError, match="does not wait for the policy"):
            ReplayRunner(EXPERT).replay(run, [0])


class TestCheckpoints:
    """Weights are not in a bundle, and are found by their digest."""

    @pytest.fixture
    def adapter(self, tmp_path: Path) -> Path:
        """Return an adapter that specifies a checkpoint, which was fetched."""
        weights, folder = tmp_path / "weights.bin", tmp_path / "policy" / "demo_policy"
        weights.write_bytes(b"weights")
        shutil.copytree(EXPERT.parent / "demo_policy", folder, ignore=shutil.ignore_patterns("__pycache__"))
        entry = {"name": "base", "source": str(weights), "sha256": hashlib.sha256(b"weights").hexdigest()}
        with (folder / "policy.yml").open("a", encoding="utf-8") as stream:
            stream.write(f"checkpoints: {json.dumps([entry])}\n")
        deploy = (folder / "deploy.yml").read_text(encoding="utf-8").replace("ckpt_name: null", "ckpt_name: base")
        (folder / "deploy.yml").write_text(deploy, encoding="utf-8")
        (one,) = specification.choose(package.load(folder), None)
        fetch.link(folder, one.name, fetch.fetch(one).path)
        return folder

    @pytest.mark.slow
    def test_a_bundle_finds_the_checkpoint_that_was_fetched(
        self, adapter: Path, report: TargetReport, tmp_path: Path
    ) -> None:
        """It is linked into the unpacked adapter; without it, nothing is run."""
        request = evaluate.EvalRequest(package.load(adapter), "offline", tmp_path / "run", PlanRequest(), films=0)
        run = evaluate.evaluate(request)
        path = tmp_path / "demo.xpl.zip"
        prepare.pack(prepare.SubmitRequest(request.package, (run.folder,), path), [run], report)
        unpacked = tmp_path / "unpacked"
        assert not [name for name in archive.unpack(path, unpacked, limit=10**8) if "weights" in name or "base" in name]
        assert _problems(path).keys() == {"audit"}  # it is of the expert
        weights = tmp_path / "weights.bin"
        weights.rename(tmp_path / "elsewhere.bin")
        with pytest.raises(UserError, match="checkpoints/base"):
            ReplayRunner(unpacked / "policy" / "demo_policy").replay(run, [0])
        (tmp_path / "elsewhere.bin").rename(weights)
        (pair,) = ReplayRunner(unpacked / "policy" / "demo_policy").replay(run, [0])
        assert pair.match in {replay.ReplayMatch.SAME, replay.ReplayMatch.OUTCOME}

    @pytest.mark.slow
    def test_weights_that_third_parties_cannot_get_are_not_packed(self, adapter: Path, tmp_path: Path) -> None:
        """What was loaded has to be specified by its digest."""
        text = (adapter / "policy.yml").read_text(encoding="utf-8")
        (adapter / "policy.yml").write_text(text.partition("checkpoints:")[0], encoding="utf-8")
        request = evaluate.EvalRequest(package.load(adapter), "offline", tmp_path / "run", PlanRequest(), films=0)
        run = evaluate.evaluate(request)
        answer = prepare.submit(prepare.SubmitRequest(request.package, (run.folder,), tmp_path / "demo.xpl.zip"))
        assert any("third parties could not get it" in problem for problem in answer.problems)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_from_evaluation_to_verification(played: Run, tmp_path: Path) -> None:
    """The commands make a bundle with a whole audit, verify it, and refuse one that was made up."""
    path = tmp_path / "expert.xpl.zip"
    code, made = _xpl("submit", "--check", str(EXPERT), str(played.folder), "--out", str(path))
    assert (code, made["problems"], made["path"]) == (0, [], str(path))
    code, answer = _xpl("verify", str(path), "--sample", "2")
    assert validate(answer, "verification") == []
    assert (
        answer["audit"]["statement"]
        == made["audit"]["statement"]
        == "GREEN contract; conversions unproven (no reference.py)"
    )
    assert (code, answer["replay"]["verdict"]) == (0, "agrees")
    assert answer["bundle"] == made["bundle"]
    forged = _forged(path, tmp_path / "forged.zip", _records(lambda lines: lines[-1].update(digest="0" * 64)))
    code, answer = _xpl("verify", str(forged), "--sample", "2")
    assert (code, answer["replay"]["verdict"], answer["replay"]["counts"]) == (
        1,
        "disagrees",
        {"same": 1, "outcome": 1},
    )


def _xpl(*arguments: str) -> tuple[int, Any]:
    done = forked.run(*arguments, "--json", cwd=EXPERT.parent.parent)
    return done.returncode, json.loads(done.stdout)
