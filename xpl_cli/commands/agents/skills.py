"""`xpl skills`: instructions for coding agents, matched to this version."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.options import JSON

app = typer.Typer(help="Skills for coding agents: list, read, install, check.", no_args_is_help=True)

_NAMES = typer.Argument([], metavar="[NAME]...", help="Skills; all by default.")
_DIR = typer.Option(None, "--dir", metavar="DIR", help="Top of the project; that of the work tree by default.")


@app.command("list")
def list_(as_json: bool = JSON) -> None:
    """List the skills with their purposes."""
    from xpl_cli import __version__
    from xpl_cli.agents.skills.bundle import bundles
    from xpl_cli.basics import console

    skills = bundles()
    following = ["xpl skills install", *(f"xpl skills get {bundle.name}" for bundle in skills[:1])]
    if as_json:
        entries = [
            {
                "name": bundle.name,
                "description": bundle.description,
                "references": [path.name for path in bundle.references],
                "lines": len(bundle.body.splitlines()),
            }
            for bundle in skills
        ]
        console.data_json({"schema": "xpl.skills-list/1", "version": __version__, "skills": entries, "next": following})
        return
    for bundle in skills:
        console.data(f"{bundle.name}\n  {bundle.description}")


@app.command()
def get(
    name: str = typer.Argument(..., metavar="NAME", help="Skill."),
    full: bool = typer.Option(False, "--full", help="With all its references."),
    as_json: bool = JSON,
) -> None:
    """Print the text of a skill of this version, also offline and if it is not installed."""
    from xpl_cli import __version__
    from xpl_cli.agents.skills.bundle import select_bundles
    from xpl_cli.basics import console

    (bundle,) = select_bundles([name])
    following = [] if full or not bundle.references else [f"xpl skills get {name} --full"]
    if as_json:
        document = {
            "schema": "xpl.skills-get/1",
            "version": __version__,
            "name": name,
            "description": bundle.description,
        }
        console.data_json({**document, "full": full, "text": bundle.text(full=full), "next": following})
        return
    console.data(bundle.text(full=full))
    for command in following:
        console.note(f"Hint: `{command}` prints its references, too")


@app.command()
@exit_codes(
    clean="all skills are installed",
    findings="a changed file was not overwritten",
    not_found="no such skill or folder",
    not_run="a folder cannot be written",
)
def install(
    names: list[str] = _NAMES,
    agents: list[str] = typer.Option([], "--agent", metavar="AGENT", help="cursor, claude or codex; all by default."),
    user: bool = typer.Option(False, "--user", help="For all projects of the user, instead of this one."),
    project: Path | None = _DIR,
    copy: bool = typer.Option(False, "--copy", help="Copies for Claude Code instead of links."),
    bare: bool = typer.Option(False, "--no-instructions", help="Leave AGENTS.md and CLAUDE.md alone."),
    overwrite: bool = typer.Option(False, "--overwrite", help="Replace skills that were edited after installation."),
    dry_run: bool = typer.Option(False, "--dry-run", help="Only say what would be done."),
    as_json: bool = JSON,
) -> None:
    """Install the skills for Cursor, Claude Code and Codex. Other files are kept."""
    from xpl_cli import __version__
    from xpl_cli.agents.skills import instructions, locations
    from xpl_cli.agents.skills.bundle import select_bundles
    from xpl_cli.agents.skills.installation import Installation
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import ExitCode, UserError, one_of

    agent_names = [agent.name for agent in locations.AGENTS]
    for agent in agents:
        one_of("--agent", agent, agent_names)
    if user and project:
        raise UserError("--user and --dir exclude each other")
    if project and not project.is_dir():
        raise UserError(f"{project} is no folder", code=ExitCode.NOT_FOUND)
    scope: locations.Scope = "user" if user else "project"
    base = locations.base(scope, project)
    selected = select_bundles(names)
    try:
        done = Installation(base, scope, copy=copy, overwrite=overwrite, dry_run=dry_run).install(
            selected, agents or agent_names
        )
        if not user and not bare:
            done += instructions.put(base, dry_run=dry_run)
    except OSError as error:
        raise UserError(f"cannot write to {error.filename}: {error.strerror}", code=ExitCode.NOT_RUN) from None
    following = [f"xpl skills check{f' --dir {_quoted(project)}' if project else ''}"]
    if as_json:
        items = [{"path": str(item.path), "state": item.state, "why": item.why} for item in done]
        document = {"schema": "xpl.skills-install/1", "version": __version__, "scope": scope, "base": str(base)}
        console.data_json({**document, "dry_run": dry_run, "items": items, "next": following})
    else:
        for item in done:
            console.data(f"{item.state:<9}  {_short(item.path, base)}{f'  ({item.why})' if item.why else ''}")
    if any(item.state == "left" for item in done):
        raise typer.Exit(ExitCode.FINDINGS)


@app.command()
@exit_codes(clean="agents get them", findings="they do not", not_found="none is installed")
def check(project: Path | None = _DIR, as_json: bool = JSON) -> None:
    """Check the installed skills: outdated copies, broken links, skipped skills, the budget.

    Looks at the project and at the user's own folders.
    """
    from dataclasses import asdict

    from xpl_cli import __version__
    from xpl_cli.agents.skills import locations
    from xpl_cli.agents.skills.check import SkillCheck
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import ExitCode, NotFoundError

    base = locations.base("project", project)
    looked = SkillCheck(base, Path.home())
    if not looked.installed():
        raise NotFoundError(f"no skill of xpl is installed in {base} or for the user", hint="run `xpl skills install`")
    findings, listings = looked.findings(), looked.listings()
    following = list(dict.fromkeys(finding.fix for finding in findings if finding.fix.startswith("xpl ")))
    if as_json:
        finding_documents = [{**asdict(finding), "path": str(finding.path)} for finding in findings]
        document = {"schema": "xpl.skills-check/1", "version": __version__, "findings": finding_documents}
        console.data_json({**document, "listings": [asdict(listing) for listing in listings], "next": following})
    else:
        for finding in findings:
            mark = "FAIL" if finding.fails else "note"
            console.data(f"{mark}  {finding.kind:<12}  {_short(finding.path, base)}: {finding.message}; {finding.fix}")
        for listing in listings:
            budget = f" of {listing.budget}" if listing.budget else ""
            console.data(
                f"{listing.agent:<6}  {listing.skills} skills, list of {listing.characters}{budget} characters"
            )
    if any(finding.fails for finding in findings):
        raise typer.Exit(ExitCode.FINDINGS)


def _short(path: Path, base: Path) -> str:
    return str(path.relative_to(base)) if path.is_relative_to(base) else str(path)


def _quoted(path: Path) -> str:
    import shlex

    return shlex.quote(str(path))
