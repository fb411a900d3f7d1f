"""Retired rules: they are explained, their codes stay taken, and a waiver that names one is no fault of the user."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from tests.support.adapters.rules import made_adapter
from tests.support.peer import xpl
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.retired import renamed, retired
from xpl_cli.basics.errors import ExitCode

if TYPE_CHECKING:
    from pathlib import Path

GONE = retired()[0]


def test_what_proves_a_retired_rule_is_a_rule_that_runs_an_adapter() -> None:
    """Nothing is proven by a rule that only reads, or by one that is gone itself."""
    for rule in retired():
        assert rule.found
        assert rule.reason
        assert all(registry.find(code).gate is not Gate.STATIC for code in rule.proven_by)


def test_explain_says_why_a_rule_is_gone_and_what_proves_the_same(tmp_path: Path) -> None:
    shown = xpl("explain", GONE.code, GONE.proven_by[0], cwd=tmp_path)
    assert shown.returncode == ExitCode.CLEAN
    assert f"{GONE.code} {GONE.slug}" in shown.stdout
    told = json.loads(xpl("explain", GONE.slug, "--json", cwd=tmp_path).stdout)
    assert (told["code"], told["retired"], told["gate"]) == (GONE.code, True, None)
    assert GONE.reason in told["documentation"]
    assert told["next"] == [f"xpl explain {code}" for code in GONE.proven_by]


def test_a_retired_rule_cannot_be_selected_and_may_be_left_out(tmp_path: Path) -> None:
    adapter = made_adapter(tmp_path / "policy/Foo")
    asked = xpl("audit", str(adapter), "--gate", "static", "--select", GONE.code, cwd=tmp_path)
    assert (asked.returncode, asked.stdout) == (ExitCode.USAGE, "")
    assert GONE.proven_by[0] in asked.stderr
    options = AuditOptions(gates=(Gate.STATIC,), ignore=(GONE.code, GONE.slug))
    assert engine.audit(adapter, "policy", options).gates[0].outcome is Outcome.PASS


def test_a_waiver_of_a_retired_rule_is_a_note(tmp_path: Path) -> None:
    adapter = made_adapter(tmp_path / "policy/Foo")
    with (adapter / "policy.yml").open("a") as manifest:
        manifest.write(f"\nwaivers: {json.dumps([{'rule': GONE.slug, 'reason': 'the library does so'}])}\n")
    after = xpl("audit", str(adapter), "--gate", "static", cwd=tmp_path)
    assert after.returncode == ExitCode.CLEAN
    assert f"waivers[0] may be deleted: {GONE.text}" in after.stderr


def test_a_former_slug_still_names_its_rule(tmp_path: Path) -> None:
    """`xpl explain`, a selection and a waiver accept it; it is not the slug of another rule."""
    slugs = {entry.slug for entry in (*registry.entries(), *retired())}
    assert not slugs & set(renamed())
    for slug, code in renamed().items():
        assert registry.find(slug).code == code
    adapter = made_adapter(tmp_path / "policy/Foo")
    (adapter / "train.sh").write_text("set -euo pipefail\nexport HTTPS_PROXY=http://10.0.0.7:3128\n")
    options = AuditOptions(gates=(Gate.STATIC,), names=("private-places",))
    assert engine.audit(adapter, "policy", options).gates[0].outcome is Outcome.FAIL
    with (adapter / "policy.yml").open("a") as manifest:
        manifest.write(f"\nwaivers: {json.dumps([{'rule': 'private-places', 'reason': 'a test'}])}\n")
    assert engine.audit(adapter, "policy", options).gates[0].outcome is Outcome.PASS
