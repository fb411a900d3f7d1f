"""Waivers: what an adapter's manifest accepts is shown and fails nothing, and what it no longer needs fails."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.adapters.rules import made_adapter, made_room
from tests.support.peer import xpl
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome, RuleResult
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.basics.errors import ExitCode

if TYPE_CHECKING:
    from pathlib import Path

REASON = "the vendor's library raises what it likes"


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """An adapter whose folder was renamed, a MUST, and with two bare excepts, a SHOULD."""
    folder = made_adapter(tmp_path / "policy/Foo")
    deploy = folder / "deploy.yml"
    deploy.write_text(deploy.read_text().replace("policy_name: Foo", "policy_name: Bar"))
    with (folder / "model.py").open("a") as model:
        model.write(
            "\n    def load(self, config):\n        try:\n            import vendor\n        except:\n"
            "            self.vendor = None\n        try:\n            self.x = 1\n        except:\n            pass\n"
        )
    return folder


def waive(adapter: Path, *waivers: dict[str, Any]) -> None:
    """Add waivers to the manifest."""
    with (adapter / "policy.yml").open("a") as manifest:
        manifest.write(f"\nwaivers: {json.dumps(waivers)}\n")


def audited(adapter: Path, *gates: Gate, names: tuple[str, ...] = ()) -> dict[str, RuleResult]:
    """Return the result of each rule."""
    report = engine.audit(adapter, "policy", AuditOptions(gates=gates or (Gate.STATIC,), names=names))
    return {result.slug: result for result in report.results}


def test_a_waived_finding_is_shown_with_its_reason_and_fails_nothing(adapter: Path) -> None:
    """The rule passes, the finding is kept apart, the gate is green, and nothing of it is fixed."""
    waive(adapter, {"rule": "deploy-config", "reason": REASON}, {"rule": "XPL131", "reason": REASON})
    results = audited(adapter)
    for slug, number in (("deploy-config", 1), ("bare-except", 2)):
        assert (results[slug].outcome, results[slug].findings) == (Outcome.PASS, ())
        assert [waived.reason for waived in results[slug].waived] == [REASON] * number
    assert results["stale-waiver"].outcome is Outcome.PASS
    done = xpl("audit", str(adapter), "--gate", "static", "--json", cwd=adapter.parent)
    assert done.returncode == ExitCode.CLEAN
    assert done.stdout.count(REASON) == 3
    diff = xpl("audit", str(adapter), "--gate", "static", "--fix", "--diff", cwd=adapter.parent)
    assert diff.stdout == ""


def test_a_message_narrows_a_waiver_to_findings_that_begin_so(adapter: Path) -> None:
    waive(adapter, {"rule": "bare-except", "reason": REASON, "message": "the reason of a failed import is hidden"})
    result = audited(adapter)["bare-except"]
    assert result.outcome is Outcome.WARN
    assert (len(result.findings), len(result.waived)) == (1, 1)


def test_a_waiver_that_covers_nothing_fails(adapter: Path) -> None:
    waive(adapter, {"rule": "bare-except", "reason": REASON}, {"rule": "print-per-inference", "reason": REASON})
    (finding,) = audited(adapter)["stale-waiver"].findings
    assert finding.message.startswith("waivers[1] ")
    assert finding.path == "policy.yml"
    assert finding.line is not None
    assert (adapter / "policy.yml").read_text().splitlines()[finding.line - 1].startswith("waivers:")


def test_a_waiver_is_judged_although_its_rule_was_not_asked_for(adapter: Path) -> None:
    waive(adapter, {"rule": "bare-except", "reason": REASON})
    assert {slug: result.outcome for slug, result in audited(adapter, names=("stale-waiver",)).items()} == {
        "stale-waiver": Outcome.PASS
    }


def test_a_rule_that_could_not_run_judges_no_waiver(adapter: Path) -> None:
    """While model.py does not parse, nobody knows what it would be accused of."""
    waive(adapter, {"rule": "reset-incomplete", "reason": REASON})
    (adapter / "model.py").write_text("class Model(:\n")
    results = audited(adapter)
    assert results["reset-incomplete"].outcome is Outcome.NOT_RUN
    assert results["stale-waiver"].outcome is Outcome.PASS


@pytest.mark.slow
def test_a_waiver_of_a_gate_that_did_not_run_is_not_judged(adapter: Path) -> None:
    """The offline gate judges it when it runs, and says nothing of waivers where none is its own."""
    assert set(audited(adapter, Gate.OFFLINE, names=("golden-provenance", "stale-waiver"))) == {"golden-provenance"}
    waive(adapter, {"rule": "batch-order", "reason": REASON})
    assert audited(adapter)["stale-waiver"].outcome is Outcome.NOT_APPLICABLE
    offline = audited(adapter, Gate.OFFLINE, names=("batch-order", "stale-waiver"))
    assert {slug: result.outcome for slug, result in offline.items()} == {
        "batch-order": Outcome.PASS,
        "stale-waiver": Outcome.FAIL,
    }


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "entry",
    [
        {"rule": "bare-except"},
        {"rule": "bare-except", "reason": " "},
        {"rule": "bare-except", "reason": 3},
        {"rule": ["bare-except"], "reason": REASON},
        "bare-except",
    ],
)
def test_an_entry_that_the_schema_refuses_waives_nothing(adapter: Path, entry: Any) -> None:
    waive(adapter, entry)
    assert audited(adapter)["bare-except"].outcome is Outcome.WARN


def test_a_crash_cannot_be_waived(adapter: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made_room(tmp_path / "room", monkeypatch).rule("crash", "raise ZeroDivisionError", code="XPL101")
    waive(adapter, {"rule": "crash", "reason": REASON})
    assert audited(adapter)["crash"].outcome is Outcome.ERROR
