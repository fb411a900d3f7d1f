"""The zoo: its data hold together, levels follow from what ran, and whoever asks is told where a fact comes from."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.checkout import ROOT
from tests.support.commands import xpl
from tests.support.recordings.runs import Faults, synthetic_run
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Finding, GateReport, Outcome, RuleResult, TargetReport
from xpl_cli.audit.rules.verdict import verdict_of
from xpl_cli.basics.errors import UserError
from xpl_cli.derived import zoo as pages
from xpl_cli.evaluation.records import fingerprints, records
from xpl_cli.standard import answers
from xpl_cli.standard.zoo import check, policies
from xpl_cli.zoo import prove

OURS = ROOT / "policy" / "demo_policy"


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a copy of the zoo, which is read in place of ours."""
    folder = tmp_path / "zoo"
    shutil.copytree(policies.folder(), folder)
    monkeypatch.setattr(policies, "folder", lambda: folder)
    policies.policies.cache_clear()
    yield folder
    policies.policies.cache_clear()


def _answer(*arguments: str | Path) -> dict[str, Any]:
    ended = xpl(*arguments, "--json")
    assert ended.code == 0, ended.stderr
    told: dict[str, Any] = json.loads(ended.stdout)
    assert answers.problems(told) == []
    return told


# -- data -------------------------------------------------------------------------------------------------------------


def test_every_policy_of_the_paper_is_there() -> None:
    """The table of the paper has 42; each fact has a value with its source, or a reason, and never both."""
    names = policies.policies()
    assert sum(policy.in_paper for policy in names) == 42
    for policy in names:
        assert tuple(policy.facts) == policies.fact_names()
        for key, fact in policy.facts.items():
            assert (fact.value is None) == bool(fact.unknown) != bool(fact.source), (policy.name, key)


def test_the_page_and_its_picture_name_every_policy() -> None:
    page, picture = pages.pages().values()
    for policy in policies.policies():
        assert policy.title in page
        assert f">{policy.title}</text>" in picture
        assert all(gate["digest"] in page for gate in (policy.proof or {"gates": ()})["gates"] if gate["digest"])
    reached = sum(policy.level.number for policy in policies.policies())
    assert picture.count('class="clean"') + picture.count('class="found"') == reached + 2  # two of the legend


FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "policies/A1.yml": ({"family": {"value": "imitation"}}, "source"),
    "policies/ACT.yml": ({"family": {"value": "imitations", "source": "a guess"}}, "imitations"),
    "policies/DP.yml": ({"chunk": {"value": 5, "source": "x", "unknown": "y"}}, "chunk"),
    "policies/GO1.yml": ({"name": "ACTS"}, "expected the file's name GO1"),
    "policies/H_RDT.yml": ({"robots": {"value": ["arx_x6"], "source": "x"}}, "no robot 'arx_x6'"),
    "proofs/A1.json": ({"level": 2}, "needs the offline gate"),
    "proofs/ACT.json": ({"level": 4}, "recorded run"),
    "proofs/DP.json": ({"next": None}, "why the next level is not reached"),
    "proofs/H_RDT.json": ({"date": "today"}, "today"),
}


def test_each_fault_of_the_data_is_found(copied: Path) -> None:
    """A guess without a source, a level without the run that it needs."""
    for file, (change, _) in FAULTS.items():
        told = {**yaml.safe_load((copied / file).read_text()), **change}
        (copied / file).write_text(json.dumps(told))  # which is YAML, too
    problems = list(check.check())
    assert {problem.file for problem in problems} == {f"zoo/{file}" for file in FAULTS}
    for file, (_, said) in FAULTS.items():
        assert any(problem.file == f"zoo/{file}" and said in str(problem) for problem in problems), (file, problems)


# -- levels -----------------------------------------------------------------------------------------------------------


def _result(code: str, outcome: Outcome, reason: str | None = None) -> RuleResult:
    findings = (Finding("it broke"),) if outcome is Outcome.FAIL else ()
    return RuleResult(code, "slug", "XPL-CON-1", "must", outcome, findings=findings, reason=reason)


def _level(**gates: list[RuleResult]) -> tuple[int, str | None]:
    """Return the level of an audit whose gates came to these results."""
    reports = [GateReport(Gate(name), results, digest="0" * 16) for name, results in gates.items()]
    report = TargetReport("policy/Foo", "Foo", "policy", gates=reports)
    return prove._level(report, verdict_of(report), None)


PASSES = _result("XPL101", Outcome.PASS)
FAILS = _result("XPL112", Outcome.FAIL)
LACKS = _result("XPL216", Outcome.NOT_RUN, "no module torch")
SERVED = _result("XPL201", Outcome.PASS)


def test_a_level_is_how_far_it_was_carried() -> None:
    """Rules that failed take no level away; a gate that could not serve it, or judged less than half, does."""
    assert _level(static=[PASSES, FAILS]) == (1, "the offline gate was not asked for")
    assert _level(static=[PASSES, LACKS]) == (0, "XPL216: no module torch")
    assert _level(static=[FAILS], offline=[SERVED, FAILS])[0] == 2
    assert _level(static=[PASSES], offline=[SERVED, LACKS]) == (1, "XPL216: no module torch")
    assert _level(static=[PASSES], offline=[SERVED, FAILS, LACKS])[0] == 2
    assert _level(static=[PASSES], offline=[_result("XPL201", Outcome.FAIL), PASSES]) == (1, "XPL201: it broke")
    silent = _result("XPL201", Outcome.NOT_RUN, "no module jax")
    assert _level(static=[PASSES], offline=[silent, PASSES, PASSES]) == (1, "XPL201: no module jax")
    assert _level(static=[PASSES], offline=[SERVED, _result("XPL217", Outcome.ERROR, "KeyError")])[0] == 1


def test_parity_and_a_recorded_run_carry_further() -> None:
    """Parity as the audit proves it; weights by a run, and not without parity."""
    parity = replace(_result("XPL260", Outcome.PASS), proof={"pairs": 24})
    provenance = _result("XPL261", Outcome.PASS)
    gates = [
        GateReport(Gate.STATIC, [PASSES], digest="0" * 16),
        GateReport(Gate.OFFLINE, [SERVED, parity, provenance], digest="0" * 16),
    ]
    report = TargetReport("policy/Foo", "Foo", "policy", gates=gates)
    assert prove._level(report, verdict_of(report), None) == (3, "no recorded run of its weights was given")
    assert prove._level(report, verdict_of(report), {"run": "it"}) == (4, None)
    gates[1].results.remove(parity)
    assert prove._level(report, verdict_of(report), {"run": "it"})[0] == 2


def test_a_run_counts_that_is_of_this_adapter_s_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of other files, or that is not finished, is refused with one sentence."""
    adapter = prove.adapter_in(policies.find("demo_policy"), ROOT)
    run = synthetic_run(tmp_path / "run", episodes=3, faults=Faults(0.0, 0.0, 0.0))
    with pytest.raises(UserError, match="other files"):
        prove._recorded_run(adapter, run)
    plan = records.read(run).plan
    monkeypatch.setattr(fingerprints, "package_digest", lambda folder: plan.policy.digest)
    told = prove._recorded_run(adapter, run)
    assert (told["environment"], told["episodes"]) == (plan.environment.name, 12)
    assert 0 <= told["successes"] <= 12
    part = synthetic_run(tmp_path / "part", episodes=3, played=5)
    with pytest.raises(UserError, match="not finished"):
        prove._recorded_run(adapter, part)


def test_an_adapter_is_proven_and_stays_as_it_is(copied: Path, tmp_path: Path) -> None:
    """The proof is written where the zoo keeps it, fits its schema, and is the same again for the same files."""
    shutil.copytree(OURS, tmp_path / "policy" / "demo_policy")
    before = {path: path.read_bytes() for path in (tmp_path / "policy").rglob("*") if path.is_file()}
    adapter = prove.adapter_in(policies.find("demo_policy"), tmp_path)
    from xpl_cli.audit.rules.options import AuditOptions

    options = AuditOptions(gates=(Gate.STATIC,))
    proof = prove.proof(adapter, options, {"embodiments": {"value": ["arx_x5"], "source": "policy.yml"}})
    assert proof["level"] == 1
    assert prove.write(proof) == copied / "proofs" / "demo_policy.json"
    assert list(check.check()) == []
    assert policies.find("demo_policy").level.number == 1
    assert prove.proof(adapter, options, proof["read"]) == proof
    model = adapter.path / "model.py"
    model.write_text(f"{model.read_text()}# more\n")
    assert prove.proof(adapter, options, {})["adapter"]["files"] != proof["adapter"]["files"]
    model.write_bytes(before[model])
    assert {path: path.read_bytes() for path in (tmp_path / "policy").rglob("*") if path.is_file()} == before


def test_folders_of_a_machine_do_not_get_into_a_proof() -> None:
    """The checkout has a name, other paths are cut; addresses and places in files are none."""
    texts = {"reason": ["/home/me/lab/policy/A1/model.py:3 wants /opt/w/last.pt, see https://a.b/c/d and policy/A1/x"]}
    cut = "CHECKOUT/policy/A1/model.py:3 wants .../last.pt, see https://a.b/c/d and policy/A1/x"
    assert prove._portable(texts, "/home/me/lab") == {"reason": [cut]}


def test_what_a_proof_holds_names_no_folder_of_this_machine() -> None:
    """It is published: a path in it is one of the checkout's."""
    for policy in policies.policies():
        text = json.dumps(policy.proof)
        assert not any(word in text for word in ("/home/", "/tmp/", "/work/", "/root/")), policy.name  # noqa: S108


# -- commands ---------------------------------------------------------------------------------------------------------


def test_the_list_is_filtered() -> None:
    """By family, robot and least level; without a command the list is what is meant."""
    assert len(_answer("zoo")["policies"]) == len(policies.policies())
    kinds = _answer("zoo", "--family", "diffusion")["policies"]
    assert {"DP", "H_RDT", "Multi_Task_DiT", "RDT_1B"} == {one["name"] for one in kinds}
    robots = _answer("zoo", "list", "--robot", "arx_x5", "--level", "1")["policies"]
    assert "A1" in {one["name"] for one in robots}
    assert all(one["level"] >= 1 and "arx_x5" in one["facts"]["robots"]["value"] for one in robots)
    assert "no policy fits" in xpl("zoo", "--level", "4", "--family", "reference").stdout


def test_a_policy_is_shown_with_the_source_of_everything() -> None:
    text = xpl("zoo", "show", "ACT").stdout
    assert "https://github.com/tonyzhaozh/act  [policy/ACT/README.md:3" in text
    assert "memory      unknown: not stated" in text
    assert _answer("zoo", "show", "RxBrain")["policy"]["proof"] is None
    ended = xpl("zoo", "show", "ACTT")
    assert (ended.code, "did you mean ACT" in ended.stderr) == (3, True)


def test_proving_tells_what_lacks(tmp_path: Path) -> None:
    """A checkout without the adapter; nothing is written without need."""
    ended = xpl("zoo", "prove", "ACT", tmp_path)
    assert (ended.code, "has no adapter in policy/ACT" in ended.stderr) == (3, True)
    message = _answer("zoo", "prove", "demo_policy", ROOT, "--gate", "static", "--dry-run")
    assert (message["file"], message["proof"]["level"]) == (None, 1)


def test_a_proof_of_other_robots_is_no_guess(copied: Path) -> None:
    policy = policies.find("A1")
    assert policy.facts["robots"].value == ["arx_x5"]
    assert (policy.facts["robots"].source or "").startswith("manifest, ")
    (copied / "proofs" / "A1.json").unlink()
    policies.policies.cache_clear()
    assert policies.find("A1").facts["robots"].value is None
    assert policies.find("A1").next == "not run here yet"
    assert replace(policy, proof=None).level.number == 0
