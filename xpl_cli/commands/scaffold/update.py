"""`xpl update`: update an adapter or environment to the current template, and keep its author's edits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from xpl_cli.commands.options import JSON

if TYPE_CHECKING:
    from xpl_cli.scaffold.update import UpdatePlan

_SCHEMA = "xpl.update/1"


def update(
    policy: Path = typer.Argument(..., metavar="PACKAGE", help="Adapter or environment, or its folder."),
    dry_run: bool = typer.Option(False, "--dry-run", help="Only say what would change."),
    force: bool = typer.Option(False, "--force", help="Also where version control has not recorded all changes."),
    as_json: bool = JSON,
) -> None:
    """Update a package to the current template. Your edits are kept."""
    import shlex

    from xpl_cli.basics import console
    from xpl_cli.basics.errors import ExitCode
    from xpl_cli.scaffold import update as updating

    folder = _own(policy)
    plan = updating.plan(folder)
    if plan.changes and not dry_run:
        if not force:
            _require_recorded(folder, policy)
        updating.apply(plan)
    following = [f"xpl audit {shlex.quote(str(policy))}"] if plan.steps else []
    if as_json:
        console.data_json(_document(plan, policy, dry_run=dry_run, following=following))
    else:
        console.data(_text(plan, policy, dry_run=dry_run, following=following))
    if plan.conflicts:
        raise typer.Exit(ExitCode.FINDINGS)


def _own(policy: Path) -> Path:
    """Return the folder of a package that the user may change.

    Raises:
        UserError: if it is one that xpl itself comes with.
    """
    from xpl_cli.basics.content import content_folder
    from xpl_cli.basics.errors import UserError
    from xpl_cli.packages.targets import find_target

    folder = find_target(policy).path.resolve()
    ours = any(folder.is_relative_to(content_folder(name).resolve()) for name in ("policy", "envs"))
    if ours and not folder.is_relative_to(Path.cwd()):
        raise UserError(
            f"{policy} is a package that xpl itself comes with, at {folder}", hint="give the path of your own"
        )
    return folder


def _require_recorded(folder: Path, policy: Path) -> None:
    """Raise if a package has uncommitted changes.

    Raises:
        UserError: with the files that differ.
    """
    from xpl_cli.basics.errors import UserError
    from xpl_cli.basics.git.history import unrecorded

    changed = unrecorded(folder)
    if changed:
        shown = ", ".join(changed[:5]) + (" ..." if len(changed) > 5 else "")
        raise UserError(
            f"{policy} has changes that git has not recorded: {shown}",
            hint="commit them first, so that git can bring them back; --force goes on without",
        )


def _state(plan: UpdatePlan, *, dry_run: bool) -> str:
    state = "conflicts" if plan.conflicts else "updated" if plan.steps else "unchanged"
    return f"would be {state}" if dry_run and state == "updated" else state


def _document(plan: UpdatePlan, policy: Path, *, dry_run: bool, following: list[str]) -> dict[str, Any]:
    return {
        "schema": _SCHEMA,
        "path": str(policy),
        "state": _state(plan, dry_run=dry_run),
        "dry_run": dry_run,
        "files": [
            {"name": step.name, "action": step.action, "conflicts": step.conflicts, "note": step.note}
            for step in plan.steps
        ],
        "next": following,
    }


def _text(plan: UpdatePlan, policy: Path, *, dry_run: bool, following: list[str]) -> str:
    if not plan.steps:
        return f"{policy}: is as its template has it, nothing to do"
    lines = [f"{policy}: {'would be updated, nothing is written' if dry_run else 'updated'}"]
    for step in plan.steps:
        places = f" ({step.conflicts} to decide)" if step.conflicts else ""
        note = f": {step.note}" if step.note else ""
        lines.append(f"  {step.action:<9} {step.name}{places}{note}")
    if plan.conflicts:
        lines.append("next: edit what stands between <<<<<<< and >>>>>>>")
    return "\n".join([*lines, *(f"next: {command}" for command in following)])
