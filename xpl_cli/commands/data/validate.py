"""`xpl data validate`: the defects of demonstrations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.basics.formats import REPORTS_HELP
from xpl_cli.commands.data.listing import SET

if TYPE_CHECKING:
    from xpl_cli.audit.formats.listing import ReportContext
    from xpl_cli.audit.rules.model import TargetReport

_FAIL_ON = ("fail", "warn")
_JSON = "json"


@exit_codes(
    clean="no findings",
    findings="findings",
    not_found="no demonstrations there",
    not_run="nothing could be checked, or a library is missing",
)
def validate(
    demonstrations: Path = SET,
    episodes: int | None = typer.Option(
        None, min=1, metavar="N", help="Check N episodes, evenly spread; default: all."
    ),
    images: bool = typer.Option(True, help="Decode every image; without, it takes seconds."),
    robot: str | None = typer.Option(None, metavar="NAME", help="The robot, for its joint limits."),
    selected: list[str] = typer.Option([], "--select", help="Run only these checks: codes, their beginnings, slugs."),
    ignored: list[str] = typer.Option([], "--ignore", help="Leave these checks out."),
    waived: list[str] = typer.Option(
        [], "--waive", metavar="CODE=REASON", help="Accept the findings of a check, with a reason."
    ),
    report_format: str = typer.Option("text", "--format", help=REPORTS_HELP),
    as_json: bool = typer.Option(False, "--json", help="The same as --format json."),
    output: list[str] = typer.Option(
        [],
        "--output",
        metavar="FILE",
        help="Write the report to a file instead of stdout. FORMAT=FILE writes one more report; may be repeated.",
    ),
    fail_on: str = typer.Option("fail", help="Mildest outcome that is an error for the exit code: fail or warn."),
) -> None:
    """Check demonstrations: schema, time, images, limits, rotations, duplicates, language, cameras."""
    import json

    from xpl_cli.audit.demonstrations import catalogue
    from xpl_cli.audit.demonstrations.validation import ValidationOptions
    from xpl_cli.audit.demonstrations.validation import validate as validated
    from xpl_cli.audit.formats.listing import ReportContext
    from xpl_cli.audit.formats.output import ReportOutput
    from xpl_cli.audit.rules.model import Outcome, exit_code
    from xpl_cli.basics import console
    from xpl_cli.basics import output as output_file
    from xpl_cli.basics.errors import UserError, one_of
    from xpl_cli.basics.progress import progress
    from xpl_cli.data.reading import open_set

    delivery = ReportOutput.parse(_JSON if as_json else report_format, output)
    one_of("--fail-on", fail_on, _FAIL_ON)
    reasons = {}
    for waiver in waived:
        name, separator, reason = waiver.partition("=")
        if not (separator and reason.strip()):
            raise UserError(
                f"--waive takes CODE=REASON, got {waiver!r}", hint="--waive XPL711='no policy here reads it'"
            )
        reasons[name] = reason.strip()
    opened = open_set(demonstrations)
    with progress() as progress_line:
        options = ValidationOptions(
            episodes, images, robot, tuple(selected), tuple(ignored), reasons, progress_line.step
        )
        report = validated(opened, str(demonstrations), options)
    context = ReportContext(
        fail_on=Outcome(fail_on),
        rule=catalogue.find,
        command=("xpl", "data", "validate"),
        selection=_choice(
            {
                "--episodes": [str(episodes)] if episodes else [],
                "--robot": [robot] if robot else [],
                "--select": selected,
                "--ignore": ignored,
                "--waive": waived,
                "--fail-on": [fail_on] if fail_on != Outcome.FAIL else [],
            },
            images=images,
        ),
    )
    for name, path in delivery.files:
        if name == _JSON:
            document = {"schema": "xpl.data-validate/1", **_document(report, context), "next": _next(report, context)}
            output_file.write(path, json.dumps(document, indent=2, ensure_ascii=False))
            console.note(f"wrote {path}")
    rest = ReportOutput(
        delivery.printed if delivery.printed != _JSON else None,
        tuple(entry for entry in delivery.files if entry[0] != _JSON),
    )
    if delivery.printed == _JSON:
        console.answer("xpl.data-validate/1", _document(report, context), _next(report, context))
    rest.deliver([report], context)
    raise typer.Exit(int(exit_code([report], Outcome(fail_on))))


def _choice(option_values: dict[str, list[str]], *, images: bool) -> tuple[str, ...]:
    """Return the options of this run as arguments of a command."""
    repeated = [part for option, values in option_values.items() for value in values for part in (option, value)]
    return (*repeated, *(() if images else ("--no-images",)))


def _next(report: TargetReport, context: ReportContext) -> list[str]:
    from xpl_cli.audit.formats.next_steps import next_commands

    return next_commands([report], context)


def _document(report: TargetReport, context: ReportContext) -> dict[str, Any]:
    """Return the report as JSON values, with results and findings as in an audit report."""
    from xpl_cli.audit.formats.document import finding_as_json
    from xpl_cli.audit.formats.listing import repository_name
    from xpl_cli.audit.rules.model import Outcome, count_outcomes, exit_code
    from xpl_cli.audit.rules.verdict import verdict_of

    (gate,) = report.gates
    folder = repository_name(context.here / report.path, context.here)
    verdict = verdict_of(report)
    results = [
        {
            "code": result.code,
            "slug": result.slug,
            "severity": result.severity,
            "outcome": result.outcome.value,
            "reason": result.reason,
            "findings": [
                finding_as_json(one, result, folder, one.fingerprint(result.code, folder)) for one in result.findings
            ],
            "waived": [
                {
                    **finding_as_json(one.finding, result, folder, one.finding.fingerprint(result.code, folder)),
                    "reason": one.reason,
                }
                for one in result.waived
            ],
        }
        for result in gate.results
    ]
    totals = count_outcomes(gate.results)
    return {
        "path": report.path,
        "verdict": verdict.status.value,
        "statement": str(verdict),
        "seconds": round(gate.seconds, 3),
        "summary": {outcome.value: totals[outcome] for outcome in Outcome},
        "exit_code": int(exit_code([report], context.fail_on)),
        "results": results,
    }
