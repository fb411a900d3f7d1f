"""A report made by hand: every outcome, and texts that formats have to escape."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator

from xpl_cli.audit.formats import ReportContext
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.measurements import RolloutSetup, SuccessMeasurement
from xpl_cli.audit.rules.model import Edit, Finding, Fix, GateReport, Outcome, RuleResult, TargetReport, Waived
from xpl_cli.audit.rules.registry import Rule

HERE = Path(__file__).parent

MODEL = """# Größe: naïve 🤖
class Model:
    def get_action_batch(self, env_idx_list=None):
        größe = env_idx_list or self.alle  # 🤖 hier
        return [self.act(i) for i, _ in enumerate(größe)]
"""


def _check() -> Iterator[Finding]:
    """The list of environments is only counted.

    ## What it does
    Follows `env_idx_list`, *and* more: a | b, <b>, 100%.

    ## Why it matters
    Robots receive each other's commands.
    """
    yield from ()


RULES = {
    code: Rule(code, slug, Gate(gate), requirement, "policy", _check, Path("conformance"))
    for code, slug, gate, requirement in (
        ("XPL101", "required-files", "static", "XPL-PKG-1"),
        ("XPL109", "batch-by-position", "static", "XPL-BAT-1"),
        ("XPL110", "empty-list-means-all", "static", "XPL-BAT-2"),
        ("XPL120", "unread-settings", "static", "XPL-CFG-4"),
        ("XPL121", "channel-swap", "static", "XPL-IMG-1"),
        ("XPL130", "private-data", "static", "XPL-PKG-1"),
        ("XPL203", "batch-order", "offline", "XPL-BAT-1"),
        ("XPL204", "batch-unknown", "offline", "XPL-BAT-3"),
        ("XPL260", "golden-parity", "offline", "XPL-NAT-3"),
        ("XPL301", "closed-loop", "mujoco", "XPL-SIM-1"),
    )
}


def result(code: str, outcome: Outcome, *findings: Finding, reason: str | None = None) -> RuleResult:
    """Return a result of one of the rules above."""
    rule = RULES[code]
    return RuleResult(code, rule.slug, rule.requirement, rule.severity, outcome, findings, reason)


def _fixable() -> Finding:
    # `env_idx_list or self.alle` in line 4; ö and ß before it take two bytes each.
    text = "self.alle if env_idx_list is None else env_idx_list"
    return Finding(
        "get_action_batch([]) answers for self.alle although no environment runs any more",
        path="model.py",
        line=4,
        column=17,
        end_line=4,
        end_column=42,
        expected="[] is answered by []",
        got="env_idx_list or self.alle",
        fix=Fix("unsafe_edit", text, (Edit("model.py", 4, 17, 4, 42, text),)),
    )


def _static() -> GateReport:
    hostile = Finding(
        "C:\\data\\new, 50% `of` <b>|bold|</b>\r\n::error file=x::not a command 🤖 \x1b[31mred\x00",
        path="scripts\\a,b:c.sh",
        line=1,
        column=2,
        end_line=3,
        end_column=4,
        expected="a path\nthat starts at the folder",
        got="``D:\\checkpoints``",
        evidence={
            "frame|1": "first\nsecond line: 100%\n::warning::third",
            "numbers": [0.1, -2.5e-3],
            "größe": {"ö": 1},
        },
        fix=Fix("command", "xpl spec show 'package files'"),
    )
    counted = Finding(
        "answers environment 3 when asked for 9", path="model.py", line=5, column=9, got="enumerate(größe)"
    )
    again = Finding("answers environment 7 when asked for 8", path="model.py", line=5, column=16)
    missing = Finding(
        "train.sh is missing: launchers that call it fail", expected="a file train.sh", got="no such file"
    )
    unread = Finding(
        "horizon of deploy.yml is never read: changing it has no effect",
        path="deploy.yml",
        line=2,
        column=1,
        expected="a key that the adapter reads",
        got="horizon",
        fix=Fix("safe_edit", "delete horizon", (Edit("deploy.yml", 2, 1, 3, 1, ""),)),
    )
    accepted = Finding("the host build.example is not there elsewhere", path="install.sh", line=1, column=6)
    return GateReport(
        Gate.STATIC,
        [
            result("XPL101", Outcome.FAIL, missing),
            result("XPL109", Outcome.FAIL, counted, again),
            result("XPL110", Outcome.FAIL, _fixable()),
            result("XPL120", Outcome.WARN, unread),
            result("XPL121", Outcome.ERROR, reason="ZeroDivisionError: on purpose (rule.py:7)"),
            RuleResult(
                "XPL130",
                "private-data",
                "XPL-PKG-1",
                "must",
                Outcome.FAIL,
                (hostile,),
                None,
                (Waived(accepted, "mirror|own"),),
            ),
        ],
        seconds=0.125,
        digest="0123456789abcdef",
        fingerprint="01234567",
    )


def reports() -> list[TargetReport]:
    """Return three targets: red, green and incomplete."""
    reason = "the static gate did not pass"
    waiting = [result(code, Outcome.NOT_RUN, reason=reason) for code in ("XPL203", "XPL204")]
    red = TargetReport("policy/Grün 1", "Grün 1", "policy", [_static(), GateReport(Gate.OFFLINE, waiting, reason)])
    proved = [result("XPL101", Outcome.PASS), result("XPL121", Outcome.NOT_APPLICABLE, reason="no image | no colour")]
    green = TargetReport("policy/Good", "Good", "policy", [_closed(Gate.STATIC, proved)])
    stopped = result(
        "XPL203", Outcome.NOT_RUN, reason="the server did not start: no module named 'torch'\n  in model.py"
    )
    measured = _closed(Gate.MUJOCO, [result("XPL101", Outcome.PASS)])
    measured.measurements = (
        SuccessMeasurement(RolloutSetup("lift_cube", "arx_x5", "joint", "set|ting"), 20, 13, 0.75),
    )
    unsure = TargetReport("policy/Heavy", "Heavy", "policy", [_closed(Gate.OFFLINE, [stopped]), measured])
    return [red, green, unsure]


def _closed(gate: Gate, results: list[RuleResult]) -> GateReport:
    return GateReport(gate, results, seconds=1.5, digest="fedcba9876543210", fingerprint="76543210")


def repository(folder: Path) -> ReportContext:
    """Write the files that the report is about, as a checkout, and return where the report is made."""
    (folder / ".git").mkdir()
    adapter = folder / "policy" / "Grün 1"
    adapter.mkdir(parents=True)
    (adapter / "model.py").write_text(MODEL, encoding="utf-8")
    (adapter / "deploy.yml").write_text("policy_name: Grün 1\nhorizon: 8\nport: 1\n", encoding="utf-8")
    (adapter / "scripts\\a,b:c.sh").write_text("cd D:\\\n\nexit\n", encoding="utf-8")
    return ReportContext(folder, Outcome.FAIL, RULES.__getitem__)


def problems(value: Any, name: str) -> list[str]:
    """Return in what way a document is not what a schema of ours says."""
    schema = json.loads((HERE / f"{name}.schema.json").read_text(encoding="utf-8"))
    Draft202012Validator.check_schema(schema)
    validator = Draft202012Validator(schema, format_checker=Draft202012Validator.FORMAT_CHECKER)
    return [f"{error.json_path}: {error.message}" for error in validator.iter_errors(value)]


def one_target(*findings: Finding, path: str = "policy/Foo", rule: str = "XPL109") -> list[TargetReport]:
    """Return a report of one rule that failed."""
    gate = GateReport(Gate.STATIC, [result(rule, Outcome.FAIL, *findings)], digest="d", fingerprint="f")
    return [TargetReport(path, Path(path).name, "policy", [gate])]
