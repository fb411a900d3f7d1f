"""What the formats share: findings one by one with their place in the repository, and checks that proved nothing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.model import Finding, GateReport, NotRun, Outcome, Result, TargetReport
from xpl_cli.audit.rules.verdict import Verdict, judged

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from xpl_cli.audit.demonstrations.check import Check

_ROOMS = frozenset(("policy", "envs"))
_SHORT = 160
_PAGE = 2000


@dataclass(frozen=True)
class Context:
    """What a report refers to besides itself.

    Attributes:
        here: working directory; the paths of targets are relative to it, or absolute.
        fail_on: the mildest outcome that the exit code counts as a finding.
        rule: finds a rule by its code.
        command: words of the command that made the report, as it is offered again.
        choice: options that chose rules, as given to `xpl audit`; commands that are offered repeat them.
        running: options that say how adapters are run, as given to `xpl audit`, `xpl serve` and `xpl eval` alike.
        beside: options that say what adapters are held against, which other commands do not take.
    """

    here: Path = field(default_factory=Path.cwd)
    fail_on: Outcome = Outcome.FAIL
    rule: Callable[[str], registry.Rule | type[Check]] = registry.find
    command: tuple[str, ...] = ("xpl", "audit")
    choice: tuple[str, ...] = ()
    running: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()


@dataclass(frozen=True)
class Listed:
    """One finding in its context.

    Attributes:
        path: its file relative to the repository, with forward slashes; the target's folder if no file is to blame.
        folder: the target's folder relative to the repository.
        disk: the target's folder.
        fingerprint: its identity, unique in the report.
    """

    target: TargetReport
    gate: GateReport
    result: Result
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
        """What belongs to the message, one thing a line: expected, got, evidence, fix, the command that explains."""
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

    def place(self, path: str) -> str:
        """Return a file of the target, given relative to its folder, relative to the repository."""
        return joined(self.folder, path)


@dataclass(frozen=True)
class Unproved:
    """Rules of one gate that crashed, or could not run, all for one reason."""

    target: TargetReport
    gate: GateReport
    outcome: Outcome
    reason: str
    results: tuple[Result, ...]
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


def listed(reports: Sequence[TargetReport], context: Context) -> Iterator[Listed]:
    """Yield every finding that counts, in the order of the report."""
    seen: Counter[str] = Counter()
    for target in reports:
        disk = context.here / target.path
        folder = in_repository(disk, context.here)
        for gate in target.gates:
            for result in gate.results:
                for finding in result.findings:
                    path = joined(folder, finding.path)
                    identity = finding.fingerprint(result.code, path)
                    seen[identity] += 1
                    fingerprint = finding.fingerprint(result.code, path, seen[identity])
                    yield Listed(target, gate, result, finding, path, folder, disk, fingerprint)


def unproved(reports: Sequence[TargetReport], context: Context) -> Iterator[Unproved]:
    """Yield what crashed and what could not run, once for each reason."""
    for target in reports:
        path = in_repository(context.here / target.path, context.here)
        for gate in target.gates:
            for (outcome, reason), results in by_reason(gate, {Outcome.ERROR, Outcome.NOT_RUN}).items():
                yield Unproved(target, gate, outcome, reason, tuple(results), path)


def verdicts(reports: Sequence[TargetReport], context: Context) -> Iterator[tuple[TargetReport, str, Verdict]]:
    """Yield what is said of each target, with its folder in the repository."""
    for target in reports:
        yield target, in_repository(context.here / target.path, context.here), judged(target)


def notes(reports: Sequence[TargetReport], context: Context) -> Iterator[tuple[str, GateReport, str]]:
    """Yield what was not real: the target's folder in the repository, the gate, and what stood in, with the reason."""
    for target in reports:
        path = in_repository(context.here / target.path, context.here)
        for gate in target.gates:
            if gate.stood_in is not None:
                yield path, gate, f"{gate.name} gate, {gate.stood_in}"


def by_reason(gate: GateReport, outcomes: set[Outcome]) -> dict[tuple[Outcome, str], list[Result]]:
    """Return the results of a gate that have some outcomes, those with one reason together."""
    found: dict[tuple[Outcome, str], list[Result]] = {}
    for result in gate.results:
        if result.outcome in outcomes:
            found.setdefault((result.outcome, result.reason or "no reason is known"), []).append(result)
    return found


def in_repository(path: Path, here: Path) -> str:
    """Return how the repository calls a folder, with forward slashes.

    The repository is the nearest folder above with a `.git`; without one the working directory, or the workspace that
    holds `policy/` and `envs/`. A folder that is in none of them keeps its absolute path.
    """
    roots = [folder for folder in path.parents if (folder / ".git").exists()][:1]
    roots += [here, *(folder.parent for folder in path.parents if folder.name in _ROOMS)]
    if (path / ".git").exists():
        roots.insert(0, path)
    root = next((root for root in roots if path.is_relative_to(root)), None)
    return (path.relative_to(root) if root is not None else path).as_posix()


def joined(folder: str, path: str | None) -> str:
    """Return a file of a folder; the folder itself without one."""
    if path is None:
        return folder
    return path if folder == "." else f"{folder}/{path}"


class Lines:
    """Lines of the files that findings are about, as the rules counted them."""

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
