"""The commands to run next, and what to do that no command does."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.causes import causes
from xpl_cli.audit.formats.listing import join_path, listed_findings
from xpl_cli.audit.rules.gates import DEMONSTRATIONS, Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, TargetReport
from xpl_cli.audit.rules.verdict import PARITY, VerdictStatus, verdict_of
from xpl_cli.basics.untrusted import command
from xpl_cli.packages import package

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.audit.formats.listing import ReportContext

_MOST_RULES = 3


def next_commands(reports: Sequence[TargetReport], context: ReportContext) -> list[str]:
    """Return the exact commands to run next, never the one that was given.

    Each can be pasted into a shell, and repeats the options of the audit that it follows.
    """
    given = "" if context.follows_review else audit_again(reports, context)
    return [line for line in dict.fromkeys(_next_commands(reports, context)) if line != given]


def advice(reports: Sequence[TargetReport], context: ReportContext) -> list[str]:
    """Return what to do next that no command does, in sentences: what to fix first, and what the machine lacks."""
    sentences = []
    if len(reports) == 1 and (found := causes(listed_findings(reports, context))):
        (report,), cause = reports, found[0]
        place = cause.located.finding
        if len(found) > 1 and place.path is not None and report.kind != DEMONSTRATIONS:
            line = "" if place.line is None else f":{place.line}"
            sentences.append(f"fix first: {join_path(report.path, place.path)}{line} ({cause.codes})")
    results = (result for report in reports for result in report.results if result.outcome is Outcome.NOT_RUN)
    return [*sentences, *dict.fromkeys(sentence for result in results for sentence in result.advice)]


def _next_commands(reports: Sequence[TargetReport], context: ReportContext) -> list[str]:
    if broken := _with(reports, Outcome.FAIL):
        again = audit_again(broken, context)
        repair = [f"{again} --fix"] if any(map(_has_safe_fix, broken)) else []
        return [*repair, *_explain_findings(broken, context), again]
    if crashed := _with(reports, Outcome.ERROR):
        return [*_explain_commands(crashed, Outcome.ERROR), audit_again(crashed, context)]
    if incomplete := [report for report in reports if verdict_of(report).status is VerdictStatus.INCOMPLETE]:
        unread = [report for report in incomplete if any(_static_gate_failed(gate) for gate in report.gates)]
        served = [report for report in incomplete if report not in unread and report.kind != DEMONSTRATIONS]
        commands = [
            command
            for report in served
            if not _needs_move(report) and _lacks_more(report)
            for command in _commands_for_what_lacks(report, context)
        ]
        explained = _explain_commands(unread, Outcome.NOT_RUN)
        return [*explained, *commands, *_record_commands(served, context), audit_again(incomplete, context)]
    return [
        *_explain_findings(reports, context),
        *_record_commands(reports, context),
        *_commands_after_green(reports, context),
    ]


def audit_again(reports: Sequence[TargetReport], context: ReportContext) -> str:
    """Return the command that audits these packages as they were audited."""
    paths = dict.fromkeys(report.path for report in reports)
    return command(
        [
            *context.command,
            *_paths(paths),
            *_gates(reports),
            *context.selection,
            *context.running,
            *context.demonstrations,
        ]
    )


def _needs_move(report: TargetReport) -> bool:
    """Return whether an environment did not run because that may move a robot: the user decides that."""
    return report.kind == package.ENV and any(gate.reason is not None for gate in report.gates)


def _record_commands(reports: Iterable[TargetReport], context: ReportContext) -> list[str]:
    """Return the commands that write the golden pairs that packages lack."""
    lacking = [report for report in reports if report.circumstances.is_unrecorded]
    return [command(["xpl", "model-io", "record", *_paths([report.path]), *context.running]) for report in lacking]


def _lacks_more(report: TargetReport) -> bool:
    """Return whether a rule could not run for another reason than missing golden pairs."""
    of_pairs = {PARITY.rule} if report.circumstances.is_unrecorded else set()
    started = (gate for gate in report.gates if gate.reason is None)  # the others wait for an earlier gate
    return {item.code for gate in started for item in gate.results if item.outcome is Outcome.NOT_RUN} != of_pairs


def _commands_for_what_lacks(report: TargetReport, context: ReportContext) -> list[str]:
    """Return the commands that install or fetch what a package lacks; the one that shows why, if that is not known."""
    path = _paths([report.path])
    lacks = {kind for result in report.results for kind in result.lacks}
    if report.kind == package.ENV or "environment" in lacks:
        return [command(["xpl", "install", *path])]
    if "hub" in lacks:
        return [command(["xpl", "checkpoint", "fetch", *path])]
    return [] if lacks else [command(["xpl", "serve", *path, *context.running])]


def _with(reports: Iterable[TargetReport], outcome: Outcome) -> list[TargetReport]:
    return [report for report in reports if any(result.outcome is outcome for result in report.results)]


def _explain_findings(reports: Sequence[TargetReport], context: ReportContext) -> list[str]:
    """Return the commands that explain the rules with the most harmful findings, then of the most packages.

    Of a failed audit they are those of failures.
    """
    found = causes(listed_findings(reports, context))
    fails = any(cause.fails for cause in found)
    counted = [entry for cause in found for entry in cause.entries if entry.fails or not fails]
    packages = Counter(code for _, code in {(id(entry.target), entry.result.code) for entry in counted})
    worst_first = sorted(counted, key=lambda entry: (entry.result.harm.rank, -packages[entry.result.code]))
    codes = dict.fromkeys(entry.result.code for entry in worst_first)
    return [f"xpl explain {code}" for code in list(codes)[:_MOST_RULES]]


def _explain_commands(reports: Iterable[TargetReport], outcome: Outcome) -> list[str]:
    """Return the commands that explain the first rules with an outcome; a rule that cannot be imported has none."""
    results = (
        result
        for report in reports
        for result in report.results
        if result.outcome is outcome and (result.requirement or report.kind == DEMONSTRATIONS)
    )
    return [f"xpl explain {code}" for code in list(dict.fromkeys(result.code for result in results))[:_MOST_RULES]]


def _commands_after_green(reports: Sequence[TargetReport], context: ReportContext) -> list[str]:
    """Return the commands after a green verdict: the other gates, then an evaluation."""
    if all(report.kind == DEMONSTRATIONS for report in reports):
        return []
    commands = [
        command(["xpl", "eval", *_paths([report.path]), "--env", gate.name, "--episodes", "10", *context.running])
        for report in reports
        for gate in report.gates
        if gate.name is Gate.MUJOCO and gate.outcome is Outcome.PASS
    ]
    if len(reports) == 1 and not context.selection and not commands:
        (report,) = reports
        if not all(any(gate.name is wanted for gate in report.gates) for wanted in Gate):
            return [command(["xpl", "audit", *_paths([report.path]), *context.running, *context.demonstrations])]
    return commands


def _has_safe_fix(report: TargetReport) -> bool:
    """Return whether `--fix` would edit something that fails."""
    findings = (finding for result in report.results if result.outcome is Outcome.FAIL for finding in result.findings)
    return any(
        finding.fix is not None and finding.fix.kind == "safe_edit" and finding.fix.edits for finding in findings
    )


def _static_gate_failed(gate: GateReport) -> bool:
    return gate.name is Gate.STATIC and gate.outcome is not Outcome.PASS


def _gates(reports: Iterable[TargetReport]) -> list[str]:
    """Return the `--gate` options for the gates of these reports; none for all gates."""
    selected = {gate.name for report in reports for gate in report.gates}
    if selected == set(Gate):
        return []
    return [part for gate in Gate if gate in selected for part in ("--gate", gate.value)]


def _paths(paths: Iterable[str]) -> list[str]:
    """Return paths as arguments; one that starts with `-` gets a leading `./`."""
    return [f"./{path}" if path.startswith("-") else path for path in paths]
