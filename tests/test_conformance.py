"""Every rule proves a requirement, catches its bad subjects and leaves its good ones alone."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

import pytest

from xpl_cli import spec
from xpl_cli.audit import engine, registry
from xpl_cli.audit.model import Gate, Outcome
from xpl_cli.audit.options import Options
from xpl_cli.audit.subjects import Subject, build, subjects

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.audit.registry import Rule

RULES = registry.rules()
SUBJECTS = [(rule, subject) for rule in RULES for subject in subjects(rule)]
HEADINGS = ("What it does", "Why it matters", "Example", "Use instead", "Fix safety")
ALLOWED = {Outcome.PASS, Outcome.NOT_APPLICABLE}

each_rule = pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.code)


def test_codes_are_unique_and_without_gaps() -> None:
    """Within each hundred the codes count up from 1."""
    codes = [rule.code for rule in RULES]
    assert [code for code, count in Counter(codes).items() if count > 1] == []
    for hundred in sorted({code[3] for code in codes}):
        numbers = sorted(int(code[4:]) for code in codes if code[3] == hundred)
        assert numbers == list(range(1, len(numbers) + 1)), f"XPL{hundred}xx"


def test_there_are_enough_rules_of_every_gate() -> None:
    """At least 12 static, 8 offline and 5 MuJoCo rules about policies, and some about environments."""
    counts = Counter((rule.gate, rule.target) for rule in RULES)
    assert counts[Gate.STATIC, "policy"] >= 12
    assert counts[Gate.OFFLINE, "policy"] >= 8
    assert counts[Gate.MUJOCO, "policy"] >= 5
    assert counts[Gate.STATIC, "env"] >= 1


@each_rule
def test_a_rule_is_what_its_folder_and_first_line_say(rule: Rule) -> None:
    """Slug is the folder's name; the code stands first in the file and names the gate."""
    entry = next(entry for entry in registry.entries() if entry.code == rule.code)
    assert (entry.slug, rule.folder.name) == (rule.slug, rule.slug)
    assert rule.gate in entry.gates
    assert (rule.target == "env") == rule.code.startswith("XPL4")


@each_rule
def test_a_rule_proves_a_requirement_and_its_severity_follows(rule: Rule) -> None:
    """MUST fails, SHOULD warns."""
    requirement = spec.requirements()[rule.requirement]
    assert rule.severity == requirement.level.lower()


@each_rule
def test_a_rule_explains_itself(rule: Rule) -> None:
    """A summary of one sentence, then the fixed headings in their order, each with text."""
    assert rule.summary.endswith(".")
    found = re.findall(r"^## (.+)\n(.+)", rule.documentation, re.MULTILINE)
    assert tuple(heading for heading, _ in found) == HEADINGS
    assert all(text.strip() for _, text in found)


@each_rule
def test_a_rule_has_a_bad_and_a_good_subject(rule: Rule) -> None:
    """A rule that nothing proves may be blind, or flag everything."""
    assert {subject.good for subject in subjects(rule)} == {True, False}


def _audit(subject: Subject, rule: Rule, folder: Path) -> engine.TargetReport:
    target = build(subject, folder / "Subject")
    return engine.audit(target, rule.target, Options(names=(rule.slug,)))


@pytest.mark.parametrize(
    ("rule", "subject"), SUBJECTS, ids=lambda item: getattr(item, "code", getattr(item, "name", ""))
)
def test_a_rule_catches_what_is_bad_and_leaves_alone_what_is_good(rule: Rule, subject: Subject, tmp_path: Path) -> None:
    """On a bad subject a finding says what the overlay asks for; on a good one there is none."""
    (result,) = _audit(subject, rule, tmp_path).results
    messages = [finding.message for finding in result.findings]
    if subject.good:
        assert result.outcome in ALLOWED, (result.reason, messages)
        return
    assert result.outcome == (Outcome.FAIL if rule.severity == "must" else Outcome.WARN), result.reason
    assert any((subject.message or "") in message for message in messages), messages


@pytest.mark.parametrize("action_type", spec.data("conventions")["action"]["types"])
@pytest.mark.parametrize("embodiment", spec.embodiments())
def test_a_plain_scaffold_has_no_static_finding_but_its_placeholders(
    embodiment: str, action_type: str, tmp_path: Path
) -> None:
    """Whatever the robot: the template follows the rules."""
    options = {"embodiment": embodiment, "action_type": action_type}
    nothing = tmp_path / "nothing"
    nothing.mkdir()
    target = build(Subject(folder=nothing, good=True, scaffold=options), tmp_path / "Subject")
    report = engine.audit(target, "policy", Options(gates=(Gate.STATIC,)))
    assert {result.slug for result in report.results if result.findings} == {"placeholders"}
    assert not any(result.outcome in {Outcome.ERROR, Outcome.NOT_RUN} for result in report.results)
