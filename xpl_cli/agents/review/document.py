"""A review as JSON: `xpl.review/1`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from xpl_cli import __version__
from xpl_cli.audit.formats import document
from xpl_cli.audit.formats.next_steps import next_commands
from xpl_cli.audit.rules.verdict import verdict_of
from xpl_cli.basics.untrusted import command

if TYPE_CHECKING:
    from xpl_cli.agents.review.review import Review, ReviewFinding

SCHEMA: Final = "xpl.review/1"


def as_json(review: Review) -> dict[str, Any]:
    """Return the review as JSON values; `audit` is the complete audit, `findings` are those that the review reports."""
    change, description = review.change, review.description
    return {
        "schema": SCHEMA,
        "tool": {"name": "xpl", "version": __version__},
        "base": {"ref": change.ref, "commit": change.base},
        "verdict": review.verdict.value,
        "packages": [
            {
                "path": touched.target.shown,
                "name": report.name,
                "kind": report.kind,
                "change": touched.change,
                "files": touched.files,
                **verdict_of(report).as_json(),
            }
            for touched, report in zip(change.packages, review.reports, strict=True)
        ],
        "removed": list(change.removed),
        "elsewhere": len(change.elsewhere),
        "findings": [_finding_as_json(remark) for remark in review.reported],
        "left_out": len(review.remarks) - len(review.reported),
        "description": None
        if description is None
        else {"form": description.form, "problems": list(description.problems), "notes": list(description.notes)},
        "audit": document.as_json(review.reports, review.context),
        "exit_code": int(review.code),
        "next": following(review),
    }


def following(review: Review) -> list[str]:
    """Return the next commands: those of the audit, and an audit of packages with unreported findings."""
    commands = next_commands(review.reports, review.context) if review.reports else []
    hidden = dict.fromkeys(remark.first.target.path for remark in review.remarks[len(review.reported) :])
    return [*commands, *([command(["xpl", "audit", *hidden])] if hidden and not commands else [])]


def _finding_as_json(remark: ReviewFinding) -> dict[str, Any]:
    first = remark.first
    return {
        "code": first.result.code,
        "slug": first.result.slug,
        "requirement": first.result.requirement,
        "package": first.target.path,
        "gate": first.gate.name.value,
        "outcome": first.result.outcome.value,
        "harm": remark.harm.name,
        "was_there_before": remark.is_old,
        **document.finding_as_json(first.finding, first.result, first.folder, first.fingerprint),
        "also": [{"path": entry.path, "line": entry.finding.line} for entry in remark.others],
    }
