"""`xpl adopt`: a manifest for an adapter that was written without one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from xpl_cli.commands.options import JSON
from xpl_cli.commands.scaffold.from_checkpoint import CAMERA, GRIPPER, STATISTICS

if TYPE_CHECKING:
    from xpl_cli.adopt.package import Adoption

_SCHEMA = "xpl.adopt/1"


def adopt(
    path: Path = typer.Argument(..., metavar="PATH", help="Folder of an adapter of the ecosystem."),
    settings: list[str] = typer.Option(
        [], "--set", metavar="KEY=VALUE", help="A value of your own: temporal.chunk=50."
    ),
    scripts: bool = typer.Option(False, "--scripts", help="Also write the scripts that are missing."),
    merge: bool = typer.Option(False, "--merge", help="Append missing keys to an existing policy.yml."),
    sources: list[Path] = typer.Option(
        [],
        "--from",
        metavar="FOLDER",
        help="Folder of the checkpoint that it runs, which fills the model_io block; once more for its data set.",
    ),
    gripper: str | None = GRIPPER,
    camera: list[str] = CAMERA,
    statistics: str | None = STATISTICS,
    dry_run: bool = typer.Option(False, "--dry-run", help="Print what would be written, and write nothing."),
    as_json: bool = JSON,
) -> None:
    """Write policy.yml for an adapter without one. What its files do not state is unknown; no other file changes."""
    from xpl_cli.adopt.package import CheckpointSource, adoption
    from xpl_cli.basics import console
    from xpl_cli.commands.scaffold.from_checkpoint import choices
    from xpl_cli.packages import package

    choices_given = choices(gripper, camera, statistics, given=bool(sources))
    trained = CheckpointSource(sources, choices_given) if sources else None
    chosen = adoption(path, package.parse_overrides(settings), merge=merge, scripts=scripts, trained=trained)
    if not dry_run:
        chosen.write()
    summary = None if dry_run else _audited(chosen.folder)
    following = _next(path, written=not dry_run)
    if as_json:
        console.data_json(
            {
                "schema": _SCHEMA,
                "path": str(path),
                "state": chosen.state if not dry_run else "would be written",
                "files": {name: content.decode() for name, content in chosen.files.items()},
                "facts": chosen.findings.facts_as_json(),
                "unknown": chosen.findings.unknown_as_json(),
                "notes": list(chosen.notes),
                "audit": summary,
                "next": following,
            }
        )
        return
    for note in chosen.notes:
        console.note(f"note: {note}")
    if dry_run:
        for name, content in chosen.files.items():
            console.note(f"+ {path / name}")
            console.data(content.decode())
        return
    _tell(path, chosen, summary or {})
    for command in following:
        console.data(f"next: {command}")


def _tell(path: Path, chosen: Adoption, summary: dict[str, Any]) -> None:
    from xpl_cli.basics import console

    findings = chosen.findings
    counted = {**findings.counts, "unknown": len(findings.unknown)}
    counts = ", ".join(f"{count} {name}" for name, count in counted.items())
    console.data(f"{path}: {chosen.state} ({', '.join(chosen.files) or 'nothing to write'}): {counts}")
    for key, leaf in findings.unknown.items():
        console.data(f"  unknown  {key}: {leaf.text}")
    console.data(f"static audit: {summary['statement']}, {summary['counts']}")
    for line in summary["findings"]:
        console.data(f"  {line}")


def _audited(folder: Path) -> dict[str, Any]:
    """Return the report of the static gate, which runs nothing of the adapter."""
    from xpl_cli.audit.engine.engine import audit
    from xpl_cli.audit.rules.gates import Gate
    from xpl_cli.audit.rules.model import Outcome
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.rules.verdict import verdict_of
    from xpl_cli.packages import package

    report = audit(folder, package.POLICY, AuditOptions(gates=(Gate.STATIC,)))
    verdict, results = verdict_of(report), report.results
    bad = [result for result in results if result.outcome in (Outcome.FAIL, Outcome.WARN, Outcome.ERROR)]
    count = {outcome: sum(result.outcome is outcome for result in results) for outcome in Outcome}
    return {
        "verdict": verdict.status.upper(),
        "statement": str(verdict),
        "counts": ", ".join(f"{number} {outcome.value}" for outcome, number in count.items() if number),
        "findings": [
            f"{result.outcome.value}  {result.code} {result.slug}: {result.findings[0].message}"
            + (f" (and {len(result.findings) - 1} more)" if len(result.findings) > 1 else "")
            for result in bad
            if result.findings
        ],
    }


def _next(path: Path, *, written: bool) -> list[str]:
    """Return the next commands for pasting."""
    import shlex

    path_text = shlex.quote(str(path))
    if not written:
        return [f"xpl adopt {path_text}"]
    return [f"xpl audit {path_text}"]
