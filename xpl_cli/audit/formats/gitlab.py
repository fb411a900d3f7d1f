"""`gitlab`: a Code Quality report, which GitLab shows in merge requests."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

from xpl_cli.audit.formats.listing import Context, Listed, Unproved, listed, unproved
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.basics.strangers import inert

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.rules.model import TargetReport

_SEVERITIES = {Outcome.ERROR: "blocker", Outcome.FAIL: "critical", Outcome.NOT_RUN: "major", Outcome.WARN: "minor"}


def render(reports: Sequence[TargetReport], context: Context) -> str:
    """Return the report as a JSON list."""
    entries = [
        {**_entry(entry, entry.result.outcome, entry.finding.line), "fingerprint": entry.fingerprint}
        for entry in listed(reports, context)
    ]
    entries += [
        {**_entry(item, item.outcome, None), "fingerprint": _identity(item)} for item in unproved(reports, context)
    ]
    return json.dumps(entries, indent=2, ensure_ascii=False)


def _entry(item: Listed | Unproved, outcome: Outcome, line: int | None) -> dict[str, Any]:
    return {
        "description": inert(item.text),
        "check_name": item.title,
        "severity": _SEVERITIES[outcome],
        # A place is required, a line too: what concerns a whole file or folder stands on its first.
        "location": {"path": item.path, "lines": {"begin": line or 1}},
    }


def _identity(item: Unproved) -> str:
    parts = (item.path, item.gate.name, item.outcome, *(result.code for result in item.results))
    return hashlib.sha256("\0".join(parts).encode(errors="replace")).hexdigest()[:16]
