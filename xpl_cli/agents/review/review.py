"""A review: the audits of changed packages, their findings in order of harm, and the check of the description."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl_cli.agents.review.change import CHANGED, change_since
from xpl_cli.agents.review.new_findings import is_old, packages_without_code_changes, without_old_findings
from xpl_cli.audit.engine.engine import audit_all
from xpl_cli.audit.formats.listing import ListedFinding, ReportContext, listed_findings
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.harm import Harm
from xpl_cli.audit.rules.model import Outcome, exit_code
from xpl_cli.audit.rules.verdict import VerdictStatus, verdict_of, weakest
from xpl_cli.audit.static.file_reading import SIZE_LIMIT
from xpl_cli.basics.errors import ExitCode
from xpl_cli.basics.progress import Progress
from xpl_cli.packages.targets import AuditTarget

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.agents.review.change import BranchChange
    from xpl_cli.agents.review.description import Description
    from xpl_cli.audit.rules.model import TargetReport
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.basics.git.history import Repository

MOST: Final = 10
"""Most findings that a review reports."""

_SIMILAR = 5


@dataclass(frozen=True)
class ReviewFinding:
    """The findings of one rule in one package.

    Attributes:
        first: the finding that is reported.
        others: the rule's other findings in the package.
        harm: kind of consequence.
        is_old: whether the base has all of them already; None if that is unknown without running the base's code.
    """

    first: ListedFinding
    others: tuple[ListedFinding, ...]
    harm: Harm
    is_old: bool | None

    @property
    def similar(self) -> tuple[ListedFinding, ...]:
        """The other findings that are listed by location."""
        return self.others[:_SIMILAR]


@dataclass(frozen=True)
class Review:
    """The review of a branch.

    Attributes:
        change: of the branch.
        reports: the audits of its packages, in their order.
        remarks: all findings, in order of harm.
        description: the check of its description; None without one.
        context: of the reports.
        new_reports: the audits without findings that the base has already.
        counts_all: whether old findings count, too.
    """

    change: BranchChange
    reports: tuple[TargetReport, ...]
    remarks: tuple[ReviewFinding, ...]
    description: Description | None
    context: ReportContext
    new_reports: tuple[TargetReport, ...] = ()
    counts_all: bool = False

    @property
    def reported(self) -> tuple[ReviewFinding, ...]:
        """The findings that are reported."""
        return self.remarks[:MOST]

    @property
    def code(self) -> ExitCode:
        """The exit code: that of the audits, or 1 if the description has problems."""
        if self.description is not None and self.description.problems:
            return ExitCode.FINDINGS
        return exit_code(self.reports if self.counts_all else self.new_reports, self.context.fail_on)

    @property
    def forgives(self) -> bool:
        """Whether the verdict ignores findings because the base has them already."""
        fail_on = self.context.fail_on
        return not self.counts_all and exit_code(self.new_reports, fail_on) != exit_code(self.reports, fail_on)

    @property
    def verdict(self) -> VerdictStatus:
        """`red` if something has to be fixed, `incomplete` if something could not be checked.

        Else the weakest verdict of the packages, and green without packages.
        """
        if self.code is not ExitCode.CLEAN:
            return VerdictStatus.RED if self.code is ExitCode.FINDINGS else VerdictStatus.INCOMPLETE
        return weakest(verdict_of(report).status for report in (self.reports if self.counts_all else self.new_reports))


def review(
    ref: str,
    repository: Repository,
    options: AuditOptions,
    *,
    context: ReportContext,
    description: str | None = None,
) -> Review:
    """Review the changes of the work tree since its merge base with a commit.

    Args:
        ref: a branch, tag or commit.
        repository: the work tree.
        options: of the audits.
        context: of the reports.
        description: text of the pull request.

    Raises:
        UserError: the commit does not exist.
    """
    from xpl_cli.agents.review import description as texts

    change = change_since(ref, repository)
    reports = audit_all([touched.target for touched in change.packages], options)
    base_fingerprints = _known_before(change, repository, options)
    read = None if description is None else texts.read(description, change, reports, repository)
    same = packages_without_code_changes(change)
    remarks = _group_findings(listed_findings(reports, context), base_fingerprints, same)
    new = without_old_findings(reports, context, base_fingerprints, same)
    return Review(change, tuple(reports), tuple(remarks), read, context, tuple(new))


def _group_findings(
    entries: Iterable[ListedFinding], base_fingerprints: set[str], same: frozenset[str]
) -> list[ReviewFinding]:
    """Group findings by rule and package; sort by outcome, harm, and whether they are new."""
    by_rule = groupby(entries, lambda entry: (entry.target.path, entry.result.code))  # reports are in this order
    remarks = []
    for _, group in by_rule:
        new_first = sorted(group, key=lambda entry: entry.fingerprint in base_fingerprints)
        first, *others = new_first
        remarks.append(
            ReviewFinding(
                first, tuple(others), Harm.of(first.result.requirement), is_old(first, base_fingerprints, same)
            )
        )
    return sorted(remarks, key=_order)


def _order(remark: ReviewFinding) -> tuple[bool, int, bool]:
    first = remark.first
    return first.result.outcome is not Outcome.FAIL, remark.harm.rank, bool(remark.is_old)


def _known_before(change: BranchChange, repository: Repository, options: AuditOptions) -> set[str]:
    """Return the fingerprints of the static gate's findings in the base; other gates would run the base's code."""
    changed = [touched for touched in change.packages if touched.change == CHANGED]
    if not changed or Gate.STATIC not in options.gates:
        return set()
    with tempfile.TemporaryDirectory(prefix="xpl-review-") as folder:
        top = Path(folder).resolve() / repository.root.name  # names a package that is the repository's root
        top.mkdir()
        (top / ".git").touch()  # marks the root, to which findings' paths are relative
        before = [
            AuditTarget(top / touched.path, touched.target.kind, touched.path)
            for touched in changed
            if repository.export(change.base, touched.path, top, largest=SIZE_LIMIT)
        ]
        static = replace(options, gates=(Gate.STATIC,), progress=Progress())
        return _fingerprints(audit_all(before, static), ReportContext(here=top))


def _fingerprints(reports: Sequence[TargetReport], context: ReportContext) -> set[str]:
    return {entry.fingerprint for entry in listed_findings(reports, context)}
