"""Causes: findings that one change of the package removes, as one entry of a report, the most harmful first.

Findings of several rules have one cause if they point to the same line, and findings of one rule in one file are one
entry. A finding of a served adapter that names only the method which answered belongs to the finding of the static gate
about the same requirement, if there is one; otherwise to others about that method in the same area of the standard.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import HANDLER

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Iterator

    from xpl_cli.audit.formats.listing import ListedFinding
    from xpl_cli.audit.rules.harm import Harm


_STATEMENT = 6
"""Lines of a statement; a longer range is a block, which may have several faults."""


@dataclass(frozen=True)
class CauseEntry:
    """The findings of one target that have one cause.

    Attributes:
        entries: its findings: failures first, then the more harmful, then in the order of the report.
    """

    entries: tuple[ListedFinding, ...]

    @property
    def first(self) -> ListedFinding:
        """The finding that counts most."""
        return self.entries[0]

    @property
    def fails(self) -> bool:
        """Whether it fails the audit, rather than warning."""
        return self.first.fails

    @cached_property
    def harm(self) -> Harm:
        """The worst harm of its findings."""
        return min(entry.result.harm for entry in self.entries)

    @cached_property
    def located(self) -> ListedFinding:
        """The finding whose location is the most exact."""
        return min(self.entries, key=lambda entry: (entry.finding.line is None, entry.finding.located_by == HANDLER))

    @cached_property
    def lines(self) -> tuple[int, ...]:
        """Its lines in the file of `located`, ascending."""
        exact = self.located.finding
        places = (entry.finding for entry in self.entries)
        found = {
            place.line
            for place in places
            if place.path == exact.path
            and place.line is not None
            and (place.located_by != HANDLER or exact.located_by == HANDLER)
        }
        return tuple(sorted(found))

    @cached_property
    def by_rule(self) -> tuple[tuple[ListedFinding, ...], ...]:
        """Its findings rule by rule."""
        groups: dict[str, list[ListedFinding]] = {}
        for entry in self.entries:
            groups.setdefault(entry.result.code, []).append(entry)
        return tuple(map(tuple, groups.values()))

    @property
    def codes(self) -> str:
        """The codes of its rules, with commas between them."""
        return ", ".join(group[0].result.code for group in self.by_rule)

    @property
    def title(self) -> str:
        """The rules: code and slug of one, the codes of several."""
        return self.first.title if len(self.by_rule) == 1 else self.codes


def causes(entries: Iterable[ListedFinding]) -> list[CauseEntry]:
    """Return the causes of findings, target by target: the most harmful first, then failures before warnings."""
    by_target: dict[int, list[ListedFinding]] = {}
    for entry in entries:
        by_target.setdefault(id(entry.target), []).append(entry)
    return [cause for found in by_target.values() for cause in sorted(_grouped(found), key=_order)]


def _order(cause: CauseEntry) -> tuple[int, bool]:
    return cause.harm.rank, not cause.fails


def _grouped(entries: list[ListedFinding]) -> Iterator[CauseEntry]:
    """Yield the causes of one target's findings, in the order of their first findings."""
    leaders = list(range(len(entries)))  # the first finding of each one's cause, so far as known

    def leader(index: int) -> int:
        while leaders[index] != index:
            index = leaders[index]
        return index

    first_with: dict[Hashable, int] = {}
    for index, entry in enumerate(entries):
        for key in _keys(entry, entries):
            earlier, later = sorted((leader(index), leader(first_with.setdefault(key, index))))
            leaders[later] = earlier
    groups: dict[int, list[ListedFinding]] = {}
    for index, entry in enumerate(entries):
        groups.setdefault(leader(index), []).append(entry)
    for members in groups.values():
        yield CauseEntry(tuple(sorted(members, key=lambda entry: (not entry.fails, entry.result.harm.rank))))


def _keys(entry: ListedFinding, entries: list[ListedFinding]) -> Iterator[Hashable]:
    """Yield what a finding shares with the others of its cause."""
    finding, result = entry.finding, entry.result
    area = result.requirement.rpartition("-")[0]
    yield "rule", result.code, finding.path
    if finding.located_by != HANDLER:
        if finding.path is not None and finding.line is not None:
            last = finding.line if finding.end_line is None else finding.end_line
            for line in range(finding.line, last + 1) if last - finding.line < _STATEMENT else (finding.line,):
                yield "line", finding.path, line
            yield "handler", finding.path, finding.line, area
        return
    for other in entries:
        if other.gate.name is Gate.STATIC and other.result.requirement == result.requirement != "":
            yield "rule", other.result.code, other.finding.path
            return
    yield "handler", finding.path, finding.line, area
