"""What a gate tried and what it did not, in the noun phrases of the rules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.model import Outcome
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl_cli.audit.rules.model import GateReport, RuleResult

_OF_THE_AUDIT = "XPL-AUD-"
"""Requirements of the audit itself: their rules try nothing of the package."""
_RAN = frozenset((Outcome.PASS, Outcome.WARN, Outcome.FAIL))


@dataclass(frozen=True)
class Untried:
    """What rules did not try, all for one reason.

    Attributes:
        subjects: noun phrases.
        reason: in a few words.
        results: those of the rules; all `not_applicable`, or all `not_run`.
    """

    subjects: tuple[str, ...]
    reason: str
    results: tuple[RuleResult, ...]


@dataclass(frozen=True)
class Coverage:
    """What the rules of a gate tried, each thing once, in the order of the rules.

    Attributes:
        tried: noun phrases.
        needless: what does not concern the package.
        prevented: what could not be tried.
    """

    tried: tuple[str, ...]
    needless: tuple[Untried, ...]
    prevented: tuple[Untried, ...]

    @classmethod
    def of(cls, gate: GateReport) -> Coverage:
        """Return the coverage of a gate."""
        results = [item for item in gate.results if not item.requirement.startswith(_OF_THE_AUDIT)]
        areas = list(spec.data("requirements")["areas"].values())
        subjects = dict.fromkeys(item.subject for item in results if item.outcome in _RAN and item.subject)
        tried = sorted(subjects, key=lambda subject: areas.index(subject) if subject in areas else len(areas))
        needless: dict[str, RuleResult] = {}
        for item in results:
            if item.outcome is Outcome.NOT_APPLICABLE and item.subject not in subjects:
                needless.setdefault(item.subject, item)
        prevented = _by_reason(item for item in results if item.outcome is Outcome.NOT_RUN)
        return cls(tuple(tried), _by_reason(needless.values()), prevented)


def _by_reason(results: Iterable[RuleResult]) -> tuple[Untried, ...]:
    groups: dict[str, list[RuleResult]] = {}
    for result in results:
        groups.setdefault(result.brief or result.reason or "no reason is known", []).append(result)
    return tuple(
        Untried(tuple(dict.fromkeys(item.subject for item in group)), reason, tuple(group))
        for reason, group in groups.items()
    )
