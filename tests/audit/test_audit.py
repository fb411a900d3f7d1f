"""The audit as a command: verdicts, exit codes, reports, digests."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.peer import xpl
from xpl_cli.audit.demonstrations import catalogue
from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.facts import Facts
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, RuleResult, TargetReport, exit_code
from xpl_cli.basics.errors import ExitCode, UserError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a fresh scaffold Foo, and Broken, a copy that answers by position."""
    folder = tmp_path_factory.mktemp("workspace")
    for name in ("Foo", "Broken"):
        assert xpl("new-policy", name, cwd=folder).returncode == ExitCode.CLEAN
    with (folder / "policy/Broken/model.py").open("a") as model:
        model.write(
            "\n    def get_action_batch(self, env_idx_list=None):\n"
            "        wanted = self._order if env_idx_list is None else self._order[: len(env_idx_list)]\n"
            "        return super().get_action_batch(wanted)\n"
        )
    return folder


@pytest.fixture(scope="module")
def green(workspace: Path) -> dict[str, Any]:
    """The JSON report of the fresh scaffold through all gates."""
    return _green(workspace)


def _green(workspace: Path, *rules: str) -> dict[str, Any]:
    done = xpl("audit", "policy/Foo", "--json", *rules, cwd=workspace)
    assert done.returncode == ExitCode.CLEAN, done.stdout + done.stderr
    report: dict[str, Any] = json.loads(done.stdout)
    return report


@pytest.mark.parametrize(
    "rules",
    [
        pytest.param([], marks=pytest.mark.slow, id="all"),
        pytest.param(["--select", "XPL1", "--select", "batch-order", "--select", "closed-loop"], id="some"),
    ],
)
def test_a_fresh_scaffold_passes_three_gates_and_is_open(
    rules: list[str], workspace: Path, request: pytest.FixtureRequest
) -> None:
    """What `xpl new-policy` writes passes static, offline and MuJoCo; `xpl.audit/1` is what its schema says."""
    from xpl_cli.standard.validate import validate

    report = _green(workspace, *rules) if rules else request.getfixturevalue("green")
    (target,) = report["targets"]
    assert (target["verdict"], target["proven"]) == ("open", [])
    assert [(gate["name"], gate["outcome"]) for gate in target["gates"]] == [(name, "pass") for name in Gate]
    assert report["summary"]["fail"] == report["summary"]["error"] == report["summary"]["not_run"] == 0
    assert validate(report, "audit") == []


def test_a_broken_copy_is_caught_with_place_and_advice(workspace: Path) -> None:
    done = xpl("audit", "policy/Broken", cwd=workspace)
    assert done.returncode == ExitCode.FINDINGS
    (line,) = [found for found in done.stdout.splitlines() if "batch-by-position" in found]
    number = int(line.rpartition("policy/Broken/model.py:")[2])
    assert "env_idx_list" in (workspace / "policy/Broken/model.py").read_text().splitlines()[number - 1]
    assert re.search(r"offline\s+not run", done.stdout)
    assert re.search(r"mujoco\s+not run", done.stdout)


@pytest.mark.slow
def test_equal_adapters_have_equal_digests_and_changed_behaviour_another(
    workspace: Path, green: dict[str, Any]
) -> None:
    """Digest and fingerprint of every gate repeat in a second run; the broken copy's static and offline ones differ."""
    again = json.loads(xpl("audit", "policy/Foo", "--json", cwd=workspace).stdout)
    finish = [gate["finish"] for gate in green["targets"][0]["gates"]]
    assert None not in finish
    assert [gate["finish"] for gate in again["targets"][0]["gates"]] == finish
    gates = ("--gate", "static", "--gate", "offline", "--keep-going")
    broken = json.loads(xpl("audit", "policy/Broken", "--json", *gates, cwd=workspace).stdout)
    for ours, theirs in zip(green["targets"][0]["gates"][:2], broken["targets"][0]["gates"], strict=True):
        assert ours["digest"] != theirs["digest"]
        assert ours["fingerprint"] == theirs["fingerprint"]


@pytest.mark.parametrize(
    ("args", "code", "said"),
    [
        (["audit", "nowhere"], ExitCode.NOT_FOUND, "no adapter at nowhere"),
        (["audit"], ExitCode.USAGE, "PATH"),
        (["audit", "policy/Foo", "--gate", "physics"], ExitCode.USAGE, "static, offline, mujoco"),
        (["audit", "policy/Foo", "--format", "xml"], ExitCode.USAGE, "text, json, sarif"),
        (["audit", "policy/Foo", "--select", "batch-odrer"], ExitCode.USAGE, "batch-order"),
        (["explain", "XPL999"], ExitCode.USAGE, "there is no rule"),
        (["audit", "policy/Foo/model.py"], ExitCode.NOT_FOUND, "takes the folder"),
    ],
)
def test_bad_usage_gets_one_clear_error(workspace: Path, args: list[str], code: ExitCode, said: str) -> None:
    done = xpl(*args, cwd=workspace)
    assert (done.returncode, done.stdout) == (code, "")
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_an_adapter_whose_libraries_are_missing_is_incomplete_not_green(workspace: Path) -> None:
    """A third-party import that fails is no fault of the adapter: where the model is demanded, not run, exit 4."""
    assert xpl("new-policy", "Heavy", cwd=workspace).returncode == ExitCode.CLEAN
    model = workspace / "policy/Heavy/model.py"
    model.write_text(model.read_text() + "\n    def load(self, config):\n        import a_library_that_is_not_here\n")
    done = xpl("audit", "policy/Heavy", "--gate", "offline", "--profile", "full", "--json", cwd=workspace)
    assert done.returncode == ExitCode.NOT_RUN
    report = json.loads(done.stdout)
    assert report["targets"][0]["verdict"] == "incomplete"
    results = report["targets"][0]["gates"][0]["results"]
    assert {result["outcome"] for result in results} == {Outcome.NOT_RUN, Outcome.NOT_APPLICABLE}
    reasons = {result["reason"] for result in results if result["outcome"] == Outcome.NOT_RUN}
    assert all("a_library_that_is_not_here" in reason for reason in reasons)


def test_explain_prints_the_documentation_of_rules_each_once_in_the_order_of_their_names(workspace: Path) -> None:
    shown = xpl("explain", "XPL203", "XPL101", "batch-order", cwd=workspace).stdout
    assert shown.index("XPL203 batch-order") < shown.index("XPL101 required-files")
    assert shown.count("XPL203 batch-order") == 1
    told = json.loads(xpl("explain", "XPL203", "XPL101", "--json", cwd=workspace).stdout)
    assert (told["schema"], [rule["code"] for rule in told["rules"]]) == ("xpl.explanations/1", ["XPL203", "XPL101"])
    assert told["rules"][0]["documentation"] == registry.find("XPL203").documentation
    assert all(heading in shown for heading in re.findall("(?m)^## (.+)", told["rules"][0]["documentation"]))


def test_rules_lists_every_rule(workspace: Path) -> None:
    listed = json.loads(xpl("rules", "--json", cwd=workspace).stdout)
    rules = [*registry.rules(), *catalogue.CHECKS]
    assert [entry["code"] for entry in listed["rules"]] == [rule.code for rule in rules]


def _gate(name: Gate, *outcomes: Outcome) -> GateReport:
    results = [
        RuleResult(f"XPL{100 + place}", "slug", "XPL-PKG-1", "must", item) for place, item in enumerate(outcomes)
    ]
    return GateReport(name=name, results=results)


@pytest.mark.parametrize(
    ("outcomes", "code"),
    [
        ([Outcome.PASS, Outcome.WARN, Outcome.NOT_APPLICABLE], ExitCode.CLEAN),
        ([Outcome.PASS, Outcome.FAIL, Outcome.ERROR], ExitCode.FINDINGS),
        ([Outcome.PASS, Outcome.ERROR, Outcome.NOT_RUN], ExitCode.INTERNAL),
        ([Outcome.PASS, Outcome.NOT_RUN], ExitCode.NOT_RUN),
        ([Outcome.NOT_APPLICABLE], ExitCode.NOT_RUN),
        ([], ExitCode.NOT_RUN),
    ],
)
def test_exit_code_is_the_worst_outcome_and_nothing_checked_is_not_clean(
    outcomes: list[Outcome], code: ExitCode
) -> None:
    """Findings outrank a crashed rule, which outranks what could not run; a gate that proved nothing is not run."""
    gates = [_gate(Gate.STATIC, *outcomes)] if outcomes else []
    target = TargetReport("policy/Foo", "Foo", "policy", gates)
    assert exit_code([target]) == code


def test_facts_are_cleaned_up_in_reverse_order() -> None:
    """A provider that yields is resumed when the facts are closed, dependants first."""
    events: list[str] = []

    def base() -> Iterator[str]:
        yield "base"
        events.append("base closed")

    def built(base: str) -> Iterator[str]:
        yield f"{base}+"
        events.append("built closed")

    with Facts({}, {"base": base, "built": built}) as facts:
        assert facts.call(lambda built: built) == "base+"
    assert events == ["built closed", "base closed"]


def test_selecting_nothing_is_an_error() -> None:
    """A misspelt rule must not turn an audit into one that checks nothing."""
    with pytest.raises(UserError, match="there is no rule"):
        registry.select(("XPL9",), (), tuple(Gate))
