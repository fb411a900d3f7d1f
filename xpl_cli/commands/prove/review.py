"""`xpl review`: the comment of a bot on a pull request."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.options import ISOLATE_HELP, JSON, MEMORY_HELP, PATIENCE_HELP, TIME_HELP

_LONGEST = 1 << 20
"""Bytes of a description; GitHub takes 65,536 characters."""
_STATIC_AND_OFFLINE = ("static", "offline")


@exit_codes(clean="no findings")
def review(
    base: str = typer.Option(..., "--base", metavar="REV", help="What the change is to be merged into."),
    description: str | None = typer.Option(
        None, metavar="FILE", help="Text of the pull request, to be held against the form for policies; - reads stdin."
    ),
    gate: list[str] = typer.Option(
        [], "--gate", help="Run only this gate; may be repeated. By default static and offline; static runs nothing."
    ),
    selected: list[str] = typer.Option([], "--select", help="Run only these rules, as for xpl audit."),
    ignored: list[str] = typer.Option([], "--ignore", help="Leave these rules out."),
    fail_on: list[str] = typer.Option(
        [],
        "--fail-on",
        help="What makes it red: new findings (the default) or all; fail (the default) or warn. May be repeated.",
    ),
    shadow: bool = typer.Option(False, "--shadow", help="Do not try the model, which runs where it can be had."),
    output: list[str] = typer.Option(
        [],
        "--output",
        metavar="FILE",
        help="Write the review to a file instead of stdout. FORMAT=FILE writes the whole audit in one of its formats.",
    ),
    no_cache: bool = typer.Option(False, "--no-cache", help="Do not reuse or store results."),
    memory_limit: str = typer.Option("80%", metavar="SIZE", help=MEMORY_HELP),
    isolate: bool = typer.Option(False, "--isolate", help=ISOLATE_HELP),
    time_limit: str = typer.Option("60m", metavar="TIME", help=TIME_HELP),
    patience: float = typer.Option(30.0, min=0.1, metavar="SECONDS", help=PATIENCE_HELP),
    as_json: bool = JSON,
) -> None:
    """Audit the packages that a change touches. Prints one comment with the ten worst findings.

    Compares the work tree with where it left REV. The offline gate runs the packages' code: where that is not to be
    trusted, --gate static reads only.
    """
    import json
    from dataclasses import replace

    from xpl_cli.agents.review import document, page
    from xpl_cli.agents.review.review import review as reviewed
    from xpl_cli.audit.engine import cache
    from xpl_cli.audit.formats import ReportContext
    from xpl_cli.audit.formats import names as format_names
    from xpl_cli.audit.formats.output import ReportOutput
    from xpl_cli.audit.rules.gates import Gate
    from xpl_cli.audit.rules.model import Outcome
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.rules.profiles import Profile
    from xpl_cli.audit.rules.time_limit import TimeLimit
    from xpl_cli.basics import console
    from xpl_cli.basics import output as output_file
    from xpl_cli.basics.errors import one_of
    from xpl_cli.basics.git.history import Repository
    from xpl_cli.basics.progress import progress
    from xpl_cli.isolation import sandbox

    for name in gate:
        one_of("--gate", name, Gate)
    for name in fail_on:
        one_of("--fail-on", name, ("new", "all", Outcome.FAIL, Outcome.WARN))
    mildest = Outcome.WARN if Outcome.WARN in fail_on else Outcome.FAIL
    known = format_names()
    formats = [wanted for wanted in output if wanted.partition("=")[0] in known and "=" in wanted]
    files = [Path(wanted) for wanted in output if wanted not in formats]
    audits = ReportOutput(None, ReportOutput.parse("text", formats).files)
    for file in files:
        output_file.check(file)
    text = None if description is None else _text(description)
    clock = TimeLimit.parse(time_limit)
    repository = Repository.of(Path.cwd())
    sandbox.check([repository.root], memory_limit=memory_limit, isolate=isolate)
    with progress() as say:
        options = AuditOptions(
            gates=tuple(name for name in Gate if name in (gate or _STATIC_AND_OFFLINE)),
            names=tuple(selected),
            ignore=tuple(ignored),
            profile=Profile.SHADOW if shadow else None,
            memory_limit=memory_limit,
            isolate=isolate,
            time_limit=clock,
            patience=patience,
            cache=None if no_cache else cache.default_folder(),
            progress=say,
        )
        context = ReportContext(
            follows_review=True,
            fail_on=mildest,
            selection=(
                *(part for name in selected for part in ("--select", name)),
                *(part for name in ignored for part in ("--ignore", name)),
                *(() if mildest is Outcome.FAIL else ("--fail-on", mildest.value)),
                *(("--shadow",) if shadow else ()),
                *(("--isolate",) if isolate else ()),
            ),
        )
        found = reviewed(base, repository, options, context=context, description=text)
        found = replace(found, counts_all="all" in fail_on)
    audits.deliver(found.reports, context)
    told = json.dumps(document.as_json(found), indent=2, ensure_ascii=False) if as_json else page.render(found)
    told = told.encode(errors="replace").decode()  # a file name may hold bytes that are no text
    for file in files:
        output_file.write(file, told)
        console.note(f"wrote {file}")
    if not files:
        console.data(told)
    raise typer.Exit(int(found.code))


def _text(file: str) -> str:
    """Return the text of a description."""
    import sys

    from xpl_cli.basics import files
    from xpl_cli.basics.errors import NotFoundError, UserError

    try:
        content = sys.stdin.buffer.read(_LONGEST + 1) if file == "-" else files.read_user_file(Path(file))
    except FileNotFoundError:
        raise NotFoundError(f"there is no file {file} for --description") from None
    except OSError as error:
        raise UserError(f"--description {file} cannot be read: {error.strerror or error}") from error
    if len(content) > _LONGEST:
        raise UserError(f"--description {file} is longer than {_LONGEST} bytes: no pull request takes that")
    return content.decode(errors="replace")
