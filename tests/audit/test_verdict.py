"""Verdicts: a word, what is proven behind it, and what is not and why."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.adapters.rules import made_adapter, made_room
from xpl_cli.audit.engine import engine
from xpl_cli.audit.engine.circumstances import describe_narrowing
from xpl_cli.audit.rules.gates import DEMONSTRATIONS, GATES, Gate
from xpl_cli.audit.rules.model import Circumstances, Finding, GateReport, Outcome, RuleResult, Waived
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.profiles import Profile, ServedProfile
from xpl_cli.audit.rules.verdict import CLAIMS, GateSummary, VerdictStatus, judge, verdict_of, weakest
from xpl_cli.packages.package import ENV, POLICY
from xpl_cli.standard import spec

NO_CODE = Circumstances(without_pairs="no reference.py")
PROOF = {"pairs": 24, "assumed": 2}


def _result(code: str, outcome: Outcome = Outcome.PASS, **more: Any) -> RuleResult:
    return RuleResult(code, code.lower(), "XPL-PKG-6", "must", outcome, **more)


def _gates(*more: RuleResult, shadow: bool = False) -> list[GateSummary]:
    """Return three gates that passed, with further results of the offline one."""
    served = ServedProfile(Profile.SHADOW) if shadow else ServedProfile()
    results = {Gate.STATIC: [_result("XPL101")], Gate.OFFLINE: [_result("XPL201"), *more]}
    reports = [GateReport(gate, results.get(gate, [_result("XPL301")])) for gate in Gate]
    return [GateSummary.of(replace(gate, served=None if gate.name is Gate.STATIC else served)) for gate in reports]


def _said(gates: list[GateSummary], around: Circumstances = NO_CODE, kind: str = POLICY) -> str:
    return str(judge(kind, gates, around))


# -- what is said ------------------------------------------------------------------------------------------------------

UNPROVEN = "conversions unproven (no reference.py)"
FINE = "nothing wrong in what ran"
PAIRS = Circumstances()
FOUND = (Finding("x"),)
WAIVED = (Waived(Finding("x"), "why"),)
PARITY = _result("XPL260", proof=PROOF)
FIT = _result("XPL270", proof={"episodes": 12})
ONE_PAIR = _result("XPL260", proof={"pairs": 1, "assumed": 1})
LEAP = _result("XPL237", Outcome.WARN, findings=(Finding("x", evidence={"shared": True}),))
CLAMPED = _result("XPL302", Outcome.WARN, findings=(Finding("x", evidence={"clamped": 0.97}),))
NONE_ASSUMED = _result("XPL260", proof={"pairs": 3, "assumed": 0})
NAMED = _result("XPL260", proof={"pairs": 5, "assumed": 2, "assumptions": ["gripper", "images[0].channels"]})
NONE_NAMED = _result("XPL260", proof={"pairs": 3, "conventions": 0, "assumed": 0, "tolerance": 1e-4})
WAITING = [_result(f"XPL20{number}", Outcome.NOT_RUN) for number in range(2, 7)]


@pytest.mark.parametrize(
    ("results", "around", "said"),
    [
        ([], NO_CODE, f"GREEN contract; {UNPROVEN}"),
        ([PARITY], PAIRS, "GREEN contract, parity (24 pairs; 2 conventions assumed; one reading twice)"),
        ([NAMED], PAIRS, "GREEN contract, parity (5 pairs; assumed: gripper, images[0].channels; one reading twice)"),
        (
            [ONE_PAIR, _result("XPL261")],
            PAIRS,
            "GREEN contract, parity (1 pair; 1 convention assumed; one reading twice)",
        ),
        (
            [PARITY, _result("XPL262", proof={"rows": 20}), LEAP],
            PAIRS,
            (
                "GREEN contract, parity (24 pairs; 2 conventions assumed; independent: kinematics of the authors' "
                "rows; one mistake may be in both (XPL237)), 1 rule warned (XPL237)"
            ),
        ),
        (
            [_result("XPL203", Outcome.FAIL, findings=FOUND)],
            replace(NO_CODE, weights="tiny random weights, cuda means the CPU"),
            f"RED 1 rule failed (XPL203), with tiny random weights, cuda means the CPU; {UNPROVEN}",
        ),
        ([NONE_ASSUMED], PAIRS, "GREEN contract, parity (3 pairs; no convention assumed; one reading twice)"),
        (
            [_result("XPL260", proof={"pairs": 3, "assumed": 0, "generated": True})],
            PAIRS,
            (
                "GREEN contract, parity (3 pairs; no convention assumed; one reading twice: reference.py was generated "
                "with the block)"
            ),
        ),
        ([NONE_NAMED], PAIRS, "GREEN contract, parity (3 pairs; no convention named; one reading twice)"),
        (
            [],
            replace(NO_CODE, settings=("seed", "ckpt_name")),
            f"GREEN contract, with --set seed, ckpt_name; {UNPROVEN}",
        ),
        (
            [_result("XPL203", waived=WAIVED * 2)],
            NO_CODE,
            f"GREEN contract; 2 findings waived (XPL203); {UNPROVEN}",
        ),
        (
            [_result("XPL260", waived=WAIVED)],
            PAIRS,
            "GREEN contract; 1 finding waived (XPL260); conversions unproven (findings of XPL260 are waived)",
        ),
        (
            [PARITY, _result("XPL261", waived=WAIVED)],
            PAIRS,
            "GREEN contract; 1 finding waived (XPL261); conversions unproven (findings of XPL261 are waived)",
        ),
        (
            [_result("XPL260", Outcome.NOT_APPLICABLE, reason="nothing to compare")],
            PAIRS,
            "GREEN contract; conversions unproven (nothing to compare)",
        ),
        ([], PAIRS, "GREEN contract; conversions unproven (XPL260 proved nothing)"),
        ([FIT, _result("XPL271")], NO_CODE, f"GREEN contract, demonstrations (12 episodes); {UNPROVEN}"),
        (
            [_result("XPL270", Outcome.FAIL, findings=FOUND)],
            NO_CODE,
            f"RED 1 rule failed (XPL270); {UNPROVEN}; conventions of training unproven (XPL270 found 1 difference)",
        ),
        (
            [FIT, _result("XPL271", Outcome.WARN, findings=FOUND)],
            NO_CODE,
            (
                f"GREEN contract, 1 rule warned (XPL271); {UNPROVEN}; "
                "conventions of training unproven (XPL271 found 1 difference)"
            ),
        ),
        (
            [CLAMPED, PARITY],
            replace(PAIRS, weights="tiny random weights"),
            (
                "GREEN contract, parity (24 pairs; 2 conventions assumed; one reading twice), tiny random weights, "
                "97% of the commands clamped, 1 rule warned (XPL302)"
            ),
        ),
        (
            [CLAMPED],
            Circumstances(narrowed="offline only"),
            f"PARTIAL offline only, 97% of the commands clamped, 1 rule warned (XPL302): {FINE}",
        ),
        ([_result("XPL203", Outcome.FAIL, findings=FOUND)], NO_CODE, f"RED 1 rule failed (XPL203); {UNPROVEN}"),
        (
            [_result("XPL203", Outcome.FAIL), PARITY],
            PAIRS,
            "RED 1 rule failed (XPL203); parity (24 pairs; 2 conventions assumed; one reading twice)",
        ),
        ([_result("XPL203", Outcome.ERROR)], NO_CODE, f"RED 1 rule crashed (XPL203); {UNPROVEN}"),
        (WAITING, NO_CODE, f"INCOMPLETE 5 rules could not run (XPL202, XPL203, XPL204 and 2 more); {UNPROVEN}"),
        ([], replace(NO_CODE, narrowed="only XPL2"), f"PARTIAL only XPL2: {FINE}"),
        (
            [PARITY],
            Circumstances(narrowed="offline only"),
            f"PARTIAL offline only: {FINE}; parity (24 pairs; 2 conventions assumed; one reading twice)",
        ),
    ],
)
def test_a_verdict_says_what_is_proven_and_what_is_not(
    results: list[RuleResult], around: Circumstances, said: str
) -> None:
    assert _said(_gates(*results), around) == said


def test_a_shadow_and_what_was_not_looked_at_prove_nothing() -> None:
    assert _said(_gates(shadow=True)) == f"SHADOW without the model: {FINE}; {UNPROVEN}"
    shadow = _said(_gates(PARITY, shadow=True), PAIRS)
    assert shadow == f"SHADOW without the model: {FINE}; conversions unproven (without the model)"
    assert _said(_gates()[:1]) == f"PARTIAL static only: {FINE}"
    left_open = replace(NO_CODE, placeholders=("a.py:3", "b.md:1"), unknown=("gripper",), narrowed="x only")
    assert _said(_gates(shadow=True), left_open) == (
        "OPEN 2 places to fill in (a.py:3 and 1 more), 1 model_io value unknown (gripper), without the model, x only: "
        f"{FINE}"
    )
    assert _said([]) == "INCOMPLETE nothing was checked"


def test_a_gate_without_anything_to_prove_is_named() -> None:
    """No robot of the adapter can be simulated: the contract holds as far as it could be tried."""
    silent = [_result("XPL301", Outcome.NOT_APPLICABLE, reason="mujoco has none of its robots")]
    gates = [*_gates()[:2], GateSummary.of(GateReport(Gate.MUJOCO, silent))]
    assert _said(gates).startswith("GREEN contract, not in the mujoco gate (mujoco has none of its robots); ")


def test_an_environment_has_no_conversions() -> None:
    assert _said(_gates()[:2], Circumstances(), ENV) == "GREEN contract"
    assert _said(_gates()[:1], Circumstances(), ENV) == "PARTIAL static only: nothing wrong in what ran"


RESULTS = st.builds(
    _result,
    st.sampled_from(["XPL101", "XPL203", "XPL260", "XPL261"]),
    st.sampled_from(Outcome),
    reason=st.sampled_from([None, "because"]),
    waived=st.sampled_from([(), (Waived(Finding("x"), "why"),)]),
    proof=st.sampled_from([None, PROOF]),
)
GATES_THAT_ENDED = st.lists(
    st.builds(
        GateReport,
        st.sampled_from(Gate),
        st.lists(RESULTS, max_size=4),
        served=st.sampled_from([None, ServedProfile(), ServedProfile(Profile.SHADOW)]),
    ).map(GateSummary.of),
    max_size=3,
    unique_by=lambda gate: gate.name,
)
AROUND = st.builds(
    Circumstances,
    st.sampled_from(["", "static only"]),
    st.sampled_from([(), ("seed",)]),
    st.sampled_from([(), ("model.py:3",)]),
    st.sampled_from([(), ("gripper",)]),
    st.sampled_from([None, "no reference.py"]),
)


@given(kind=st.sampled_from([POLICY, ENV]), gates=GATES_THAT_ENDED, around=AROUND)
def test_no_verdict_says_more_than_what_ran(kind: str, gates: list[GateSummary], around: Circumstances) -> None:
    """Whatever comes together: every claim is proven or not, and GREEN takes all gates, the model, and nothing open."""
    verdict = judge(kind, gates, around)
    claims = [claim.claim for claim in (*verdict.proven, *verdict.unproven)]
    assert sorted(claim.name for claim in claims) == sorted(claim.name for claim in CLAIMS[kind])
    assert str(verdict).startswith(f"{verdict.status.upper()} ")
    assert verdict.details.strip()
    words = {item.claim.name for item in verdict.proven}
    assert ("contract" in words) == (verdict.status is VerdictStatus.GREEN)
    outcomes = {gate.outcome for gate in gates}
    if verdict.status is VerdictStatus.GREEN:
        assert {gate.name for gate in gates} >= set(GATES[kind])
        assert outcomes <= {Outcome.PASS, Outcome.NOT_APPLICABLE}
        assert (around.narrowed, around.placeholders, around.unknown) == ("", (), ())
        assert not any(gate.stood_in for gate in gates)
    if "parity" in words:
        assert around.without_pairs is None
        assert not any({"XPL260", "XPL261"} & gate.doubts.keys() for gate in gates)
    assert (verdict.status is VerdictStatus.RED) == bool(outcomes & {Outcome.FAIL, Outcome.ERROR})
    assert json.loads(json.dumps(verdict.as_json())) == verdict.as_json()


def test_several_packages_come_to_the_least_of_them() -> None:
    assert weakest([VerdictStatus.GREEN, VerdictStatus.OPEN, VerdictStatus.PARTIAL]) is VerdictStatus.OPEN
    assert weakest([VerdictStatus.GREEN, VerdictStatus.RED, VerdictStatus.INCOMPLETE]) is VerdictStatus.RED
    assert weakest([]) is VerdictStatus.GREEN


# -- where it is told --------------------------------------------------------------------------------------------------


def test_the_schema_knows_the_words_and_the_claims() -> None:
    definitions = spec.schema("audit")["$defs"]
    assert set(definitions["target"]["properties"]["verdict"]["enum"]) == set(VerdictStatus)
    # What is said of demonstrations has a document of its own.
    claims = {claim.name for kind, offered in CLAIMS.items() if kind != DEMONSTRATIONS for claim in offered}
    assert set(definitions["claim"]["enum"]) == claims


# -- what a package and a request leave open ---------------------------------------------------------------------------


@pytest.fixture
def adapter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scaffold in which nothing is left to fill in, and a room of rules that find nothing."""
    room = made_room(tmp_path / "room", monkeypatch)
    room.rule("reads", "yield from ()", code="XPL101")
    room.rule("runs", "yield from ()", code="XPL201", folder="offline")
    room.rule("drives", "yield from ()", code="XPL301", folder="mujoco")
    package = made_adapter(tmp_path / "policy" / "Foo")
    mark = spec.data("package")["placeholder"]
    for file in (path for path in package.iterdir() if path.is_file()):
        file.write_text(file.read_text().replace(mark, "done"))
    return package


def _audited(adapter: Path, **options: Any) -> str:
    return str(verdict_of(engine.audit(adapter, POLICY, AuditOptions(**options), display_path="policy/Foo")))


def test_what_a_request_leaves_out_is_told(adapter: Path) -> None:
    """By gates, by rules and by rules that are left out; all gates by name are all gates."""
    assert _audited(adapter, gates=tuple(Gate)) == "GREEN contract; conversions unproven (no reference.py)"
    told = _audited(adapter, gates=(Gate.STATIC,), names=("XPL101",))
    assert told == "PARTIAL static only, only XPL101: nothing wrong in what ran"
    assert describe_narrowing(POLICY, AuditOptions(gates=(Gate.STATIC, Gate.OFFLINE))) == "static and offline only"
    assert describe_narrowing(POLICY, AuditOptions(names=("XPL1", "runs"))) == "only XPL1, runs"
    assert describe_narrowing(POLICY, AuditOptions(ignore=("drives",))) == "without drives"


def test_what_a_package_leaves_open_is_told(adapter: Path) -> None:
    mark = spec.data("package")["placeholder"]
    with (adapter / "policy.yml").open("a") as manifest:
        manifest.write("model_io: {images: [{input: image, channels: {unknown: nobody says}}]}\n")
    assert _audited(adapter).startswith("OPEN 1 model_io value unknown (images[0].channels): nothing wrong")
    readme = (adapter / "README.md").read_text()
    (adapter / "README.md").write_text(f"<!-- {mark}: what it does -->\n{readme}")
    assert _audited(adapter).startswith("OPEN 1 place to fill in (README.md:1), 1 model_io value unknown")


def test_a_reference_that_was_not_recorded_has_its_command(adapter: Path) -> None:
    (adapter / "reference.py").write_text("CONVENTIONS = {}\n")
    reason = "reference.py was not recorded: xpl model-io record policy/Foo"
    assert _audited(adapter) == f"GREEN contract; conversions unproven ({reason})"
    assert engine.audit(adapter, POLICY, AuditOptions()).circumstances.is_unrecorded
    (adapter / "golden_pairs.json").write_text("{}\n")
    assert not engine.audit(adapter, POLICY, AuditOptions()).circumstances.is_unrecorded
    assert _audited(adapter) == "GREEN contract; conversions unproven (XPL260 proved nothing)"
