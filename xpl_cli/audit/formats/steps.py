"""What to do next, as exact commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.audit.rules.gates import DEMONSTRATIONS, Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, TargetReport
from xpl_cli.audit.rules.verdict import PARITY, Word, judged
from xpl_cli.basics.untrusted import command
from xpl_cli.packages import package

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.audit.formats.listing import Context

_MOST_RULES = 3


def next_commands(reports: Sequence[TargetReport], context: Context) -> list[str]:
    """Return the exact commands that are worth running next, the audit that shows success last.

    Each can be pasted into a shell, and repeats the options of the audit that it follows.
    """
    if broken := _with(reports, Outcome.FAIL):
        again = audit_again(broken, context)
        repair = [f"{again} --fix"] if any(map(_is_repairable, broken)) else []
        return [*repair, *_explained(broken, Outcome.FAIL), again]
    if crashed := _with(reports, Outcome.ERROR):
        return [*_explained(crashed, Outcome.ERROR), audit_again(crashed, context)]
    if incomplete := [report for report in reports if judged(report).word is Word.INCOMPLETE]:
        unread = [report for report in incomplete if any(_is_unread(gate) for gate in report.gates)]
        served = [report for report in incomplete if report not in unread and report.kind != DEMONSTRATIONS]
        commands = [
            _shown_alone(report, context) for report in served if not _is_withheld(report) and _lacks_more(report)
        ]
        explained = _explained(unread, Outcome.NOT_RUN)
        return [*explained, *commands, *_recorded(served, context), audit_again(incomplete, context)]
    return [*_explained(reports, Outcome.WARN), *_recorded(reports, context), *_onward(reports, context)]


def audit_again(reports: Sequence[TargetReport], context: Context) -> str:
    """Return the command that audits these packages as they were audited."""
    paths = dict.fromkeys(report.path for report in reports)
    return command(
        [*context.command, *_paths(paths), *_gates(reports), *context.choice, *context.running, *context.beside]
    )


def _is_withheld(report: TargetReport) -> bool:
    """Tell whether an environment was not played because that may move a robot: a person decides that, and no list."""
    return report.kind == package.ENV and any(gate.reason is not None for gate in report.gates)


def _recorded(reports: Iterable[TargetReport], context: Context) -> list[str]:
    """Return the commands that write the golden pairs that packages lack."""
    lacking = [report for report in reports if report.circumstances.is_unrecorded]
    return [command(["xpl", "model-io", "record", *_paths([report.path]), *context.running]) for report in lacking]


def _lacks_more(report: TargetReport) -> bool:
    """Tell whether something could not run for another reason than that golden pairs are missing."""
    of_pairs = {PARITY.rule} if report.circumstances.is_unrecorded else set()
    return {item.code for item in report.results if item.outcome is Outcome.NOT_RUN} != of_pairs


def _shown_alone(report: TargetReport, context: Context) -> str:
    """Return the command that shows, or makes, what a package needs in order to run."""
    path = _paths([report.path])
    return command(
        ["xpl", "install", *path] if report.kind == package.ENV else ["xpl", "serve", *path, *context.running]
    )


def _with(reports: Iterable[TargetReport], outcome: Outcome) -> list[TargetReport]:
    return [report for report in reports if any(result.outcome is outcome for result in report.results)]


def _explained(reports: Iterable[TargetReport], outcome: Outcome) -> list[str]:
    """Return the commands that explain the first rules that ended so; one that cannot be imported explains nothing."""
    results = (
        result
        for report in reports
        for result in report.results
        if result.outcome is outcome and (result.requirement or report.kind == DEMONSTRATIONS)
    )
    return [f"xpl explain {code}" for code in list(dict.fromkeys(result.code for result in results))[:_MOST_RULES]]


def _onward(reports: Sequence[TargetReport], context: Context) -> list[str]:
    """Return what comes after a package that is green: the gates that were not asked for, then an evaluation."""
    if all(report.kind == DEMONSTRATIONS for report in reports):
        return []
    commands = [
        command(["xpl", "eval", *_paths([report.path]), "--env", gate.name, "--episodes", "10", *context.running])
        for report in reports
        for gate in report.gates
        if gate.name is Gate.MUJOCO and gate.outcome is Outcome.PASS
    ]
    if len(reports) == 1 and not context.choice and not commands:
        (report,) = reports
        if not all(any(gate.name is wanted for gate in report.gates) for wanted in Gate):
            return [command(["xpl", "audit", *_paths([report.path]), *context.running, *context.beside])]
    return commands


def _is_repairable(report: TargetReport) -> bool:
    """Tell whether `--fix` would do something about what fails."""
    found = (finding for result in report.results if result.outcome is Outcome.FAIL for finding in result.findings)
    return any(finding.fix is not None and finding.fix.kind == "safe_edit" and finding.fix.edits for finding in found)


def _is_unread(gate: GateReport) -> bool:
    return gate.name is Gate.STATIC and gate.outcome is not Outcome.PASS


def _gates(reports: Iterable[TargetReport]) -> list[str]:
    """Return the options that ask for the gates of these reports, none where all were asked for."""
    asked = {gate.name for report in reports for gate in report.gates}
    if asked == set(Gate):
        return []
    return [part for gate in Gate if gate in asked for part in ("--gate", gate.value)]


def _paths(paths: Iterable[str]) -> list[str]:
    """Return paths as arguments; one that begins like an option is written so that it is none."""
    return [f"./{path}" if path.startswith("-") else path for path in paths]
