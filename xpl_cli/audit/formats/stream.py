"""`jsonl`: one JSON object a line and finding (`xpl.finding/1`), for tools that filter line by line.

Rules that crashed or could not run have a line too: an audit that proved nothing must not look like a clean one. The
last lines (`xpl.verdict/1`) say what each package comes to.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from xpl_cli.audit.formats.document import described
from xpl_cli.audit.formats.listing import Context, listed, unproved, verdicts
from xpl_cli.audit.rules.model import Finding
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.audit.rules.model import GateReport, Result, TargetReport


def render(reports: Sequence[TargetReport], context: Context) -> str:
    """Return the lines."""
    lines = (*records(reports, context), *_verdicts(reports, context))
    return "".join(f"{json.dumps(line, ensure_ascii=False)}\n" for line in lines)


def records(reports: Sequence[TargetReport], context: Context) -> Iterator[dict[str, Any]]:
    """Yield the objects, as `#/$defs/record` of audit.schema.json describes them."""
    for entry in listed(reports, context):
        head = _head(entry.target, entry.gate, entry.result)
        yield head | described(entry.finding, entry.result, entry.folder, entry.fingerprint)
    for item in unproved(reports, context):
        silent = Finding(item.reason)
        for result in item.results:
            fingerprint = silent.fingerprint(result.code, item.path)
            yield _head(item.target, item.gate, result) | described(silent, result, item.path, fingerprint)


def _verdicts(reports: Sequence[TargetReport], context: Context) -> Iterator[dict[str, Any]]:
    """Yield the objects that `#/$defs/verdict` describes."""
    schema = spec.schema("audit", spec.NEWEST)["$defs"]["verdict"]["properties"]["schema"]["const"]
    for target, _, verdict in verdicts(reports, context):
        yield {"schema": schema, "target": target.path, **verdict.as_json()}


def _head(report: TargetReport, gate: GateReport, result: Result) -> dict[str, Any]:
    return {
        "schema": spec.schema("audit")["$defs"]["record"]["properties"]["schema"]["const"],
        "target": report.path,
        "gate": gate.name.value,
        "code": result.code,
        "slug": result.slug,
        "requirement": result.requirement,
        "severity": result.severity,
        "outcome": result.outcome.value,
    }
