"""The description of a pull request, held against the form for submissions and against what the audit finds here."""

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

    from xpl_cli.agents.review.change import Change
    from xpl_cli.audit.rules.model import TargetReport
    from xpl_cli.basics.git.history import Repository

TEMPLATE: Final = ".github/PULL_REQUEST_TEMPLATE/policy.md"
"""The form, from the top of a repository."""

_FINISH = re.compile(
    r"XPL-FINISH gate=(?P<gate>\w+) (?P<outcome>\w+) .*?digest=(?P<digest>\w+) fingerprint=(?P<fingerprint>\w+)"
    r"(?: profile=(?P<profile>\w+))?"
)


@dataclass(frozen=True)
class Description:
    """What a description leaves open.

    Attributes:
        form: the form that it was held against; None if the change brings no policy, or the repository has no form.
        problems: sentences on what is to be mended.
        notes: sentences on what could not be compared.
    """

    form: str | None
    problems: tuple[str, ...]
    notes: tuple[str, ...]


def read(text: str, change: Change, reports: Sequence[TargetReport], repository: Repository) -> Description:
    """Read a description.

    It has to follow the form if the change adds a policy, or if it was begun with the form. The form is that of the
    base, so that no change softens what it is held to; a repository that gets its first one has it in the work tree.

    Args:
        text: the description.
        change: what it describes.
        reports: the audits of this review.
        repository: the work tree.
    """
    template = repository.text(change.base, TEMPLATE) or _in_work_tree(repository)
    adds = any(touched.change == ADDED and touched.target.kind == package.POLICY for touched in change.packages)
    is_held = template is not None and (adds or form.uses(text, template))
    claims = [match.groupdict() for match in _FINISH.finditer(text)]
    gates = [gate for report in reports if report.kind == package.POLICY for gate in report.gates]
    problems = [*form.open_places(text, template), *_unproved(claims)] if is_held and template is not None else []
    notes = [] if is_held else [_why_not_held(template)]
    for claim in claims:
        alike = [gate for gate in gates if _is_comparable(claim, gate)]
        if not alike:
            notes.append(
                f"the {claim['gate']} gate was run on another machine or version: its digest proves nothing here"
            )
        elif all(gate.digest != claim["digest"] for gate in alike):
            found = " or ".join(dict.fromkeys(str(gate.digest) for gate in alike))
            problems.append(
                f"the {claim['gate']} gate of the description is not that of these files: "
                f"expected digest {found}, got {claim['digest']}"
            )
    return Description(TEMPLATE if is_held else None, tuple(dict.fromkeys(problems)), tuple(dict.fromkeys(notes)))


def _why_not_held(template: str | None) -> str:
    if template is None:
        return f"the description was held against no form: there is no {TEMPLATE} in this repository"
    return f"the description was held against no form: the change adds no policy, and it was not begun with {TEMPLATE}"


def _unproved(claims: list[dict[str, str | None]]) -> Iterator[str]:
    """Yield what finish lines that were pasted do not prove."""
    if not claims:
        yield "no line XPL-FINISH is given: what was audited, nobody can tell"
        return
    for gate in Gate:
        found = [claim for claim in claims if claim["gate"] == gate]
        if not found:
            yield f"the line XPL-FINISH of the {gate} gate is missing"
        for claim in found:
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
