"""`sarif`: SARIF 2.1.0 as code scanning of GitHub reads it.

Every result there becomes an alert, so only findings are results. Rules that crashed or could not run are notifications
of the run. The run has no `automationDetails`: the uploader chooses the category.
"""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING
from urllib.parse import quote_from_bytes

from xpl_cli import __version__
from xpl_cli.audit.formats.causes import CauseEntry, causes
from xpl_cli.audit.formats.linehash import line_hashes
from xpl_cli.audit.formats.listing import (
    ListedFinding,
    ReportContext,
    UnprovenRules,
    listed_findings,
    notes,
    shortened,
    unproven_rules,
    verdicts,
)
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.basics.untrusted import without_links
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.audit.demonstrations.check import DemonstrationCheck
    from xpl_cli.audit.rules.model import Edit, Finding, TargetReport
    from xpl_cli.audit.rules.registry import Rule

ROOT = "%SRCROOT%"
"""Name for the root of the repository, which code scanning knows."""

_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
_MOST = 1024
"""Code scanning takes descriptions up to this many characters."""

_LEVELS = {"must": "error", "should": "warning"}


def render(reports: Sequence[TargetReport], context: ReportContext) -> str:
    """Return the report as one JSON document."""
    slugs = {result.code: result.slug for report in reports for result in report.results}
    rule_indices = {code: place for place, code in enumerate(sorted(slugs))}
    hashes = _LineHashCache()
    open_ends = list(unproven_rules(reports, context))
    run = {
        "tool": {
            "driver": {
                "name": "xpl",
                "semanticVersion": __version__,
                "rules": [_rule(code, slugs[code], context) for code in rule_indices],
            }
        },
        "invocations": [
            {
                "executionSuccessful": all(entry.outcome is not Outcome.ERROR for entry in open_ends),
                "toolExecutionNotifications": [
                    *(_notification(entry, rule_indices) for entry in open_ends),
                    *(
                        {"level": "note", "message": {"text": f"{path}: {note}"}}
                        for path, _, note in notes(reports, context)
                    ),
                ],
            }
        ],
        "columnKind": "unicodeCodePoints",
        "originalUriBaseIds": {ROOT: {"description": {"text": "The root of the repository."}}},
        "properties": {
            "verdicts": [
                {"target": path, **said.as_json(), "statement": without_links(str(said))}
                for _, path, said in verdicts(reports, context)
            ]
        },
        "results": [
            _result(entry, cause, rule_indices, hashes)
            for cause in causes(listed_findings(reports, context))
            for entry in cause.entries
        ],
    }
    return json.dumps({"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]}, indent=2, ensure_ascii=False)


def _rule(code: str, slug: str, context: ReportContext) -> dict[str, object]:
    try:
        return _describe_rule(context.rule(code))
    except (Exception, SystemExit):  # noqa: BLE001 - a rule that cannot be imported crashed; its notification says how
        return {"id": code, "name": slug, "shortDescription": {"text": slug}}


def _describe_rule(rule: Rule | type[DemonstrationCheck]) -> dict[str, object]:
    level = _LEVELS[rule.severity]
    proves = ""
    if rule.requirement:  # checks of demonstrations have none
        requirement = spec.requirements()[rule.requirement]
        proves = f"Proves {requirement.id} ({requirement.level}): {requirement.text}"
    return {
        "id": rule.code,
        "name": rule.slug,
        "shortDescription": {"text": shortened(rule.summary, _MOST)},
        "fullDescription": {"text": shortened(f"{rule.summary} {proves}".strip(), _MOST)},
        "help": {
            "text": rule.documentation,
            "markdown": f"{rule.documentation}\n\n*{proves}*\n" if proves else f"{rule.documentation}\n",
        },
        "defaultConfiguration": {"level": level},
        "properties": {
            "tags": [tag for tag in (rule.gate.value, rule.target, rule.requirement) if tag],
            "precision": "high",
            "problem.severity": level,
        },
    }


def _result(
    entry: ListedFinding, cause: CauseEntry, rule_indices: dict[str, int], hashes: _LineHashCache
) -> dict[str, object]:
    finding = entry.finding
    # Code scanning distinguishes alerts by this one key. If there is no line to compute it from, it is our own.
    line_hash = hashes.of(entry.disk, finding) or f"{entry.fingerprint}:1"
    result: dict[str, object] = {
        "ruleId": entry.result.code,
        "ruleIndex": rule_indices[entry.result.code],
        "level": "error" if entry.fails else "warning",
        "message": {"text": without_links(entry.text)},
        "locations": [{"physicalLocation": _physical(entry)}],
        "partialFingerprints": {"primaryLocationLineHash": line_hash, "xplFinding/v1": entry.fingerprint},
        "properties": {
            "gate": entry.gate.name.value,
            "requirement": entry.result.requirement,
            "harm": entry.result.harm.name,
            "cause": cause.first.fingerprint,
        },
    }
    if finding.fix is not None and finding.fix.edits:
        result["fixes"] = [{"description": {"text": finding.fix.text}, "artifactChanges": _changes(entry)}]
    return result


def _physical(entry: ListedFinding) -> dict[str, object]:
    finding = entry.finding
    location: dict[str, object] = {"artifactLocation": artifact(entry.path)}
    if finding.line is not None:
        location["region"] = _region(finding)
    return location


def _region(item: Finding | Edit) -> dict[str, object]:
    keys = {"startLine": item.line, "startColumn": item.column}
    if item.end_line is not None:
        keys |= {"endLine": item.end_line, "endColumn": item.end_column}
    return {key: value for key, value in keys.items() if value is not None}


def artifact(path: str) -> dict[str, str]:
    """Return the location of a file: relative to the repository, or absolute if it is in none."""
    uri = quote_from_bytes(os.fsencode(path))
    return {"uri": f"file://{uri}"} if path.startswith("/") else {"uri": uri, "uriBaseId": ROOT}


def _changes(entry: ListedFinding) -> list[dict[str, object]]:
    fix = entry.finding.fix
    by_file: dict[str, list[Edit]] = {}
    for edit in fix.edits if fix is not None else ():
        by_file.setdefault(edit.path, []).append(edit)
    return [
        {
            "artifactLocation": artifact(entry.repository_path(path)),
            "replacements": [
                {"deletedRegion": _region(edit), "insertedContent": {"text": edit.text}} for edit in edits
            ],
        }
        for path, edits in by_file.items()
    ]


def _notification(entry: UnprovenRules, rule_indices: dict[str, int]) -> dict[str, object]:
    first = entry.results[0]
    return {
        "level": "error" if entry.outcome is Outcome.ERROR else "warning",
        "message": {"text": without_links(f"{entry.path}: {entry.text}")},
        "associatedRule": {"id": first.code, "index": rule_indices[first.code]},
    }


class _LineHashCache:
    """Line hashes of the files with findings."""

    def __init__(self) -> None:
        self._files: dict[Path, list[str]] = {}

    def of(self, folder: Path, finding: Finding) -> str | None:
        """Return the hash of a finding's first line; None if it cannot be read."""
        if finding.path is None or finding.line is None:
            return None
        file = folder / finding.path
        if file not in self._files:
            try:
                self._files[file] = line_hashes(file.read_bytes())
            except (OSError, ValueError):
                self._files[file] = []
        hashes = self._files[file]
        return hashes[finding.line - 1] if finding.line <= len(hashes) else None
