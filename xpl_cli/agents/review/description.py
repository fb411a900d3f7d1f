"""Check of a pull request's description against the submission template and against the audit's results."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.agents.review import form
from xpl_cli.agents.review.change import ADDED
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.packages import package

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.agents.review.change import BranchChange
    from xpl_cli.audit.rules.model import TargetReport
    from xpl_cli.basics.git.history import Repository

TEMPLATE: Final = ".github/PULL_REQUEST_TEMPLATE/policy.md"
"""The template, relative to the repository's root."""

_FINISH = re.compile(
    r"XPL-FINISH gate=(?P<gate>\w+) (?P<outcome>\w+) .*?digest=(?P<digest>\w+) fingerprint=(?P<fingerprint>\w+)"
    r"(?: profile=(?P<profile>\w+))?"
)


@dataclass(frozen=True)
class Description:
    """The check of a description.

    Attributes:
        form: the template that it was checked against; None if no policy is added, or the repository has no template.
        problems: what has to be fixed, one sentence each.
        notes: what could not be compared, one sentence each.
    """

    form: str | None
    problems: tuple[str, ...]
    notes: tuple[str, ...]


def read(text: str, change: BranchChange, reports: Sequence[TargetReport], repository: Repository) -> Description:
    """Check a description.

    It has to follow the template if the branch adds a policy, or if it has one of the template's headings. The template
    is taken from the merge base, so that a branch cannot weaken it; a repository's first one from the work tree.

    Args:
        text: the description.
        change: of the branch.
        reports: the audits of this review.
        repository: the work tree.
    """
    template = repository.text(change.base, TEMPLATE) or _in_work_tree(repository)
    adds = any(touched.change == ADDED and touched.target.kind == package.POLICY for touched in change.packages)
    is_held = template is not None and (adds or form.uses(text, template))
    claims = [match.groupdict() for match in _FINISH.finditer(text)]
    gates = [gate for report in reports if report.kind == package.POLICY for gate in report.gates]
    problems = (
        [*form.unfilled_fields(text, template), *_unproved_claims(claims)] if is_held and template is not None else []
    )
    notes = [] if is_held else [_why_not_held(template)]
    for claim in claims:
        alike = [gate for gate in gates if _is_comparable(claim, gate)]
        if not alike:
            notes.append(
                f"the {claim['gate']} gate was run on another machine or version: its digest proves nothing here"
            )
        elif all(gate.digest != claim["digest"] for gate in alike):
            expected = " or ".join(dict.fromkeys(str(gate.digest) for gate in alike))
            problems.append(
                f"the {claim['gate']} gate of the description is not that of these files: "
                f"expected digest {expected}, got {claim['digest']}"
            )
    return Description(TEMPLATE if is_held else None, tuple(dict.fromkeys(problems)), tuple(dict.fromkeys(notes)))


def _why_not_held(template: str | None) -> str:
    if template is None:
        return f"the description was not checked: there is no {TEMPLATE} in this repository"
    return f"the description was not checked: the change adds no policy, and has no heading of {TEMPLATE}"


def _unproved_claims(claims: list[dict[str, str | None]]) -> Iterator[str]:
    """Yield what the pasted finish lines do not prove."""
    if not claims:
        yield "it has no XPL-FINISH line, so it does not prove any audit"
        return
    for gate in Gate:
        matching = [claim for claim in claims if claim["gate"] == gate]
        if not matching:
            yield f"the XPL-FINISH line of the {gate} gate is missing"
        for claim in matching:
            if claim["outcome"] != Outcome.PASS:
                yield f"the {gate} gate did not pass: its line says {claim['outcome']}"
            if claim["profile"] == Profile.SHADOW:
                yield f"the {gate} gate ran without the model: run it where the weights are"


def _is_comparable(claim: dict[str, str | None], gate: GateReport) -> bool:
    return (claim["gate"], claim["fingerprint"]) == (gate.name, gate.fingerprint) and gate.digest is not None


def _in_work_tree(repository: Repository) -> str | None:
    try:
        return (repository.root / TEMPLATE).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
