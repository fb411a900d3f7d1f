"""What the formats share: findings with their path in the repository, and rules that proved nothing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.model import Finding, GateReport, NotRun, Outcome, RuleResult, TargetReport
from xpl_cli.audit.rules.verdict import Verdict, verdict_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from xpl_cli.audit.demonstrations.check import DemonstrationCheck

_WORKSPACE_FOLDERS = frozenset(("policy", "envs"))
_SHORT = 160
_PAGE = 2000


@dataclass(frozen=True)
class ReportContext:
    """Context of a report: working directory and options.

    Attributes:
        here: working directory; the paths of targets are relative to it, or absolute.
        fail_on: the mildest outcome that the exit code counts as a finding.
        rule: returns a rule by its code.
        command: words of the command that made the report.
        selection: options that selected rules; suggested commands repeat them.
        running: options for running adapters, the same for `xpl audit`, `xpl serve` and `xpl eval`.
        demonstrations: the option `--demos`, which other commands do not have.
        follows_review: whether another command than `command` was given, so that this one may be next.
    """

    here: Path = field(default_factory=Path.cwd)
    fail_on: Outcome = Outcome.FAIL
    rule: Callable[[str], registry.Rule | type[DemonstrationCheck]] = registry.find
    command: tuple[str, ...] = ("xpl", "audit")
    selection: tuple[str, ...] = ()
    running: tuple[str, ...] = ()
    demonstrations: tuple[str, ...] = ()
    follows_review: bool = False


@dataclass(frozen=True)
class ListedFinding:
    """A finding with its target, gate, rule and path.

    Attributes:
        path: its file relative to the repository, with forward slashes; the target's folder if the finding is in no
            file.
        folder: the target's folder relative to the repository.
        disk: the target's folder.
        fingerprint: its identity, unique in the report.
    """

    target: TargetReport
    gate: GateReport
    result: RuleResult
    finding: Finding
    path: str
    folder: str
    disk: Path
    fingerprint: str

    @property
    def title(self) -> str:
        """Code and slug of the rule."""
        return f"{self.result.code} {self.result.slug}"

    @property
    def fails(self) -> bool:
        """Whether it fails the audit, rather than warning."""
        return self.result.outcome is Outcome.FAIL

    @cached_property
    def details(self) -> list[str]:
        """Lines below the message: expected, got, evidence, fix, the command that explains the rule."""
        finding = self.finding
        lines = [f"{name}: {value}" for name, value in (("expected", finding.expected), ("got", finding.got)) if value]
        lines += [f"{name}: {shortened(value, _PAGE)}" for name, value in (finding.evidence or {}).items()]
        if finding.fix is not None:
            lines.append(f"fix: {finding.fix.text}")
        return [*lines, f"explain: {self.result.explain}"]

    @property
    def text(self) -> str:
        """The message and its details."""
        return "\n".join((self.finding.message, *self.details))

    def repository_path(self, path: str) -> str:
        """Return the path in the repository of a file of the target."""
        return join_path(self.folder, path)


@dataclass(frozen=True)
class UnprovenRules:
    """Rules of one gate that crashed, or could not run, all for one reason."""

    target: TargetReport
    gate: GateReport
    outcome: Outcome
    reason: str
    results: tuple[RuleResult, ...]
    path: str

    @property
    def title(self) -> str:
        """The first rule, and how many more."""
        first, *others = self.results
        return f"{first.code} {first.slug}" + (f" and {len(others)} more" if others else "")

    @property
    def text(self) -> str:
        """One sentence."""
        what = "crashed" if self.outcome is Outcome.ERROR else "could not run"
        return f"{self.title} {what}: {self.reason}"


def listed_findings(reports: Sequence[TargetReport], context: ReportContext) -> Iterator[ListedFinding]:
    """Yield every finding that counts, in the order of the report."""
    counts: Counter[str] = Counter()
    for target in reports:
        disk = context.here / target.path
        folder = repository_name(disk, context.here)
        for gate in target.gates:
            for result in gate.results:
                for finding in result.findings:
                    path = join_path(folder, finding.path)
                    identity = finding.fingerprint(result.code, path)
                    counts[identity] += 1
                    fingerprint = finding.fingerprint(result.code, path, counts[identity])
                    yield ListedFinding(target, gate, result, finding, path, folder, disk, fingerprint)


def unproven_rules(reports: Sequence[TargetReport], context: ReportContext) -> Iterator[UnprovenRules]:
    """Yield the rules that crashed or could not run, once for each reason."""
    for target in reports:
        path = repository_name(context.here / target.path, context.here)
        for gate in target.gates:
            for (outcome, reason), results in by_reason(gate, {Outcome.ERROR, Outcome.NOT_RUN}).items():
                yield UnprovenRules(target, gate, outcome, reason, tuple(results), path)


def verdicts(reports: Sequence[TargetReport], context: ReportContext) -> Iterator[tuple[TargetReport, str, Verdict]]:
    """Yield the verdict of each target, with its folder in the repository."""
    for target in reports:
        yield target, repository_name(context.here / target.path, context.here), verdict_of(target)


def notes(reports: Sequence[TargetReport], context: ReportContext) -> Iterator[tuple[str, GateReport, str]]:
    """Yield gates without the real model: the target's folder in the repository, the gate, and the reason."""
    for target in reports:
        path = repository_name(context.here / target.path, context.here)
        for gate in target.gates:
            if gate.stood_in is not None:
                yield path, gate, f"{gate.name} gate, {gate.stood_in}"


def by_reason(gate: GateReport, outcomes: set[Outcome]) -> dict[tuple[Outcome, str], list[RuleResult]]:
    """Return the results of a gate with these outcomes, grouped by outcome and by the root of the reason."""
    groups: dict[tuple[Outcome, str], list[RuleResult]] = {}
    for result in gate.results:
        if result.outcome in outcomes:
            reason = result.brief or result.reason or "no reason is known"
            groups.setdefault((result.outcome, reason), []).append(result)
    return groups


def repository_name(path: Path, here: Path) -> str:
    """Return a folder's path in the repository, with forward slashes.

    The repository is the nearest folder above with a `.git`; without one the working directory, or the workspace that
    holds `policy/` and `envs/`. A folder that is in none of them keeps its absolute path.
    """
    roots = [folder for folder in path.parents if (folder / ".git").exists()][:1]
    roots += [here, *(folder.parent for folder in path.parents if folder.name in _WORKSPACE_FOLDERS)]
    if (path / ".git").exists():
        roots.insert(0, path)
    root = next((root for root in roots if path.is_relative_to(root)), None)
    return (path.relative_to(root) if root is not None else path).as_posix()


def join_path(folder: str, path: str | None) -> str:
    """Return a file of a folder; the folder itself without one."""
    if path is None:
        return folder
    return path if folder == "." else f"{folder}/{path}"


class SourceLines:
    """Lines of the files with findings, as the rules counted them."""

    def __init__(self) -> None:
        self._files: dict[tuple[Path, str], list[str] | None] = {}

    def of(self, disk: Path, path: str) -> list[str] | None:
        """Return the lines of a file of a target; None if it cannot be read."""
        from xpl_cli.audit.static.source import Source

        key = (disk, path)
        if key not in self._files:
            try:
                self._files[key] = Source(disk).text(path).split("\n")
            except (NotRun, OSError, ValueError):
                self._files[key] = None
        return self._files[key]


def shortened(value: object, most: int = _SHORT) -> str:
    """Return a value as text of bounded length."""
    text = str(value)
    return text if len(text) <= most else f"{text[: most - 3]}..."
