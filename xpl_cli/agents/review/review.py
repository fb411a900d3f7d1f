"""One review: the audits of what a change touches, its findings in order of harm, and what its description lacks."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl_cli.agents.review.change import CHANGED, change_since
from xpl_cli.agents.review.harm import Harm, harm
from xpl_cli.agents.review.judgement import brought, is_old, unchanged
from xpl_cli.audit.engine.engine import audit_all
from xpl_cli.audit.formats.listing import Context, Listed, listed
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome, exit_code
from xpl_cli.audit.rules.verdict import Word, judged, weakest
from xpl_cli.audit.static.reading import SIZE_LIMIT
from xpl_cli.basics.errors import ExitCode
from xpl_cli.basics.progress import Progress
from xpl_cli.packages.targets import Target

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.agents.review.change import Change
    from xpl_cli.agents.review.description import Description
    from xpl_cli.audit.rules.model import TargetReport
    from xpl_cli.audit.rules.options import Options
    from xpl_cli.basics.git.history import Repository

MOST: Final = 10
"""Findings that a review tells: more are not read."""

_SIMILAR = 5


@dataclass(frozen=True)
class Remark:
    """What one rule found in one package.

    Attributes:
        first: the finding that is told.
        others: the rule's other findings there.
        harm: what such a fault does.
        is_old: whether the base has all of them already; None where nobody can tell without running the base's code.
    """

    first: Listed
    others: tuple[Listed, ...]
    harm: Harm
    is_old: bool | None

    @property
    def similar(self) -> tuple[Listed, ...]:
        """The others that are named by their place."""
        return self.others[:_SIMILAR]


@dataclass(frozen=True)
class Review:
    """What is said of a change.

    Attributes:
        change: what it touches.
        reports: the audits of its packages, in their order.
        remarks: all of them, in order of harm.
        description: what its description lacks; None where none was given.
        context: what reports refer to.
        brought: the audits without what was there before.
        counts_all: whether what was there before counts, too.
    """

    change: Change
    reports: tuple[TargetReport, ...]
    remarks: tuple[Remark, ...]
    description: Description | None
    context: Context
    brought: tuple[TargetReport, ...] = ()
    counts_all: bool = False

    @property
    def told(self) -> tuple[Remark, ...]:
        """The remarks that are told."""
        return self.remarks[:MOST]

    @property
    def code(self) -> ExitCode:
        """The exit code: that of the audits, and findings where the description lacks something."""
        if self.description is not None and self.description.problems:
            return ExitCode.FINDINGS
        return exit_code(self.reports if self.counts_all else self.brought, self.context.fail_on)

    @property
    def forgives(self) -> bool:
        """Whether findings were left out of the verdict because they were there before."""
        fail_on = self.context.fail_on
        return not self.counts_all and exit_code(self.brought, fail_on) != exit_code(self.reports, fail_on)

    @property
    def verdict(self) -> Word:
        """`red` where something has to be mended, `incomplete` where something could not be checked.

        Else what the package comes to of which least can be said, and green where the change touches none.
        """
        if self.code is not ExitCode.CLEAN:
            return Word.RED if self.code is ExitCode.FINDINGS else Word.INCOMPLETE
        return weakest(judged(report).word for report in (self.reports if self.counts_all else self.brought))


def review(
    ref: str,
    repository: Repository,
    options: Options,
    *,
    context: Context,
    description: str | None = None,
) -> Review:
    """Review what the work tree changes since it left a commit's history.

    Args:
        ref: a branch, tag or commit.
        repository: the work tree.
        options: how the packages are audited.
        context: what reports refer to.
        description: text of the pull request.

    Raises:
        UserError: if there is no such commit.
    """
    from xpl_cli.agents.review import description as texts

    change = change_since(ref, repository)
    reports = audit_all([touched.target for touched in change.packages], options)
    known = _known_before(change, repository, options)
    read = None if description is None else texts.read(description, change, reports, repository)
    same = unchanged(change)
    remarks = _remarks(listed(reports, context), known, same)
    new = brought(reports, context, known, same)
    return Review(change, tuple(reports), tuple(remarks), read, context, tuple(new))


def _remarks(entries: Iterable[Listed], known: set[str], same: frozenset[str]) -> list[Remark]:
    """Return findings, those of one rule in one package together: what fails, what is worse, what is new, first."""
    by_rule = groupby(entries, lambda entry: (entry.target.path, entry.result.code))  # reports are in this order
    remarks = []
    for _, found in by_rule:
        new_first = sorted(found, key=lambda entry: entry.fingerprint in known)
        first, *others = new_first
        remarks.append(Remark(first, tuple(others), harm(first.result.requirement)[1], is_old(first, known, same)))
    return sorted(remarks, key=_order)


def _order(remark: Remark) -> tuple[bool, int, bool]:
    first = remark.first
    return first.result.outcome is not Outcome.FAIL, harm(first.result.requirement)[0], bool(remark.is_old)


def _known_before(change: Change, repository: Repository, options: Options) -> set[str]:
    """Return what the static gate finds in the packages as the base has them; no other gate, which would run them."""
    changed = [touched for touched in change.packages if touched.change == CHANGED]
    if not changed or Gate.STATIC not in options.gates:
        return set()
    with tempfile.TemporaryDirectory(prefix="xpl-review-") as folder:
        top = Path(folder).resolve() / repository.root.name  # a package at the top has its name from there
        top.mkdir()
        (top / ".git").touch()  # marks the top, from which findings count their paths
        before = [
            Target(top / touched.place, touched.target.kind, touched.place)
            for touched in changed
            if repository.export(change.base, touched.place, top, largest=SIZE_LIMIT)
        ]
        static = replace(options, gates=(Gate.STATIC,), progress=Progress())
        return _fingerprints(audit_all(before, static), Context(here=top))


def _fingerprints(reports: Sequence[TargetReport], context: Context) -> set[str]:
    return {entry.fingerprint for entry in listed(reports, context)}
