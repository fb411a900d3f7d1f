"""`xpl audit`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from xpl_cli.basics.formats import REPORTS_HELP
from xpl_cli.commands.options import (
    ISOLATE_HELP,
    MEMORY_HELP,
    PATIENCE_HELP,
    POLICY_ENV,
    PYTHON,
    SETTINGS,
    TIME_HELP,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.packages.targets import AuditTarget

_GATES = ("static", "offline", "mujoco")
_FAIL_ON = ("fail", "warn")
_PROFILES = ("full", "shadow")


def audit(
    paths: list[Path] = typer.Argument(None, metavar="PATH...", help="Folders of adapters or environments."),
    every: bool = typer.Option(False, "--all", help="All packages below policy/ and envs/."),
    gate: list[str] = typer.Option([], "--gate", help="Run this gate: static, offline, mujoco; repeatable."),
    selected: list[str] = typer.Option([], "--select", help="Run these rules: codes, code prefixes, slugs, advice."),
    ignored: list[str] = typer.Option([], "--ignore", help="Skip these rules."),
    report_format: str = typer.Option("text", "--format", help=REPORTS_HELP, rich_help_panel="Report"),
    as_json: bool = typer.Option(False, "--json", help="The same as --format json.", rich_help_panel="Report"),
    output: list[str] = typer.Option(
        [],
        "--output",
        metavar="FILE",
        help="File for the report; FORMAT=FILE: one more; repeatable.",
        rich_help_panel="Report",
    ),
    fix: bool = typer.Option(False, "--fix", help="Apply the safe fixes, then audit.", rich_help_panel="Fixes"),
    unsafe_fixes: bool = typer.Option(
        False,
        "--unsafe-fixes",
        help="Also fixes that may change correct behaviour.",
        rich_help_panel="Fixes",
    ),
    diff: bool = typer.Option(
        False,
        "--diff",
        help="Print the fixes as a diff; exit 1 if there are any.",
        rich_help_panel="Fixes",
    ),
    changed_since: str | None = typer.Option(
        None,
        metavar="REF",
        help="Audit packages changed since the merge base with REF.",
    ),
    keep_going: bool = typer.Option(False, "--keep-going", help="Continue after a gate that failed."),
    fail_on: str = typer.Option("fail", help="Exit with 1 from this severity: fail or warn.", rich_help_panel="Report"),
    no_cache: bool = typer.Option(False, "--no-cache", help="Do not reuse or store results."),
    profile: str | None = typer.Option(
        None,
        metavar="PROFILE",
        help="full (real model) or shadow; default: best possible.",
        rich_help_panel="Adapter",
    ),
    shadow: bool = typer.Option(False, "--shadow", help="The same as --profile shadow.", rich_help_panel="Adapter"),
    task: list[str] = typer.Option(
        [],
        metavar="NAME",
        help="Task of the MuJoCo gate; repeatable.",
        rich_help_panel="Physics and demonstrations",
    ),
    episodes: int | None = typer.Option(
        None,
        min=1,
        metavar="N",
        help="Episodes of the MuJoCo gate's success rate.",
        rich_help_panel="Physics and demonstrations",
    ),
    demos: Path | None = typer.Option(
        None,
        metavar="PATH",
        help="Demonstrations to compare the policy with.",
        rich_help_panel="Physics and demonstrations",
    ),
    pictures: Path | None = typer.Option(
        None,
        metavar="DIR",
        help="Save plots of predicted and demonstrated actions.",
        rich_help_panel="Physics and demonstrations",
    ),
    video: Path | None = typer.Option(
        None,
        metavar="DIR",
        help="Save a video of every MuJoCo episode.",
        rich_help_panel="Physics and demonstrations",
    ),
    move: bool = typer.Option(
        False,
        "--move",
        help="Also run real-time environments: moves real robots.",
        rich_help_panel="Physics and demonstrations",
    ),
    memory_limit: str = typer.Option("80%", metavar="SIZE", help=MEMORY_HELP, rich_help_panel="Bounds"),
    isolate: bool = typer.Option(False, "--isolate", help=ISOLATE_HELP, rich_help_panel="Bounds"),
    time_limit: str = typer.Option("60m", metavar="TIME", help=TIME_HELP, rich_help_panel="Bounds"),
    patience: float = typer.Option(30.0, min=0.1, metavar="SECONDS", help=PATIENCE_HELP, rich_help_panel="Bounds"),
    settings: list[str] = SETTINGS,
    python: str | None = PYTHON,
    policy_env: str | None = POLICY_ENV,
) -> None:
    """Audit packages in three gates: static, offline, MuJoCo."""
    from xpl_cli.audit.engine import cache
    from xpl_cli.audit.engine.engine import audit_all
    from xpl_cli.audit.formats.listing import ReportContext
    from xpl_cli.audit.formats.output import ReportOutput
    from xpl_cli.audit.rules.gates import Gate
    from xpl_cli.audit.rules.model import Outcome, exit_code
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.rules.profiles import Profile
    from xpl_cli.audit.rules.time_limit import TimeLimit
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import UserError, one_of
    from xpl_cli.basics.progress import progress
    from xpl_cli.isolation import sandbox
    from xpl_cli.packages import package

    delivery = ReportOutput.parse("json" if as_json else report_format, output)
    profile = _parse_profile(profile, shadow=shadow)
    for name in gate:
        one_of("--gate", name, _GATES)
    one_of("--fail-on", fail_on, _FAIL_ON)
    one_of("--profile", profile or _PROFILES[0], _PROFILES)
    if unsafe_fixes and not (fix or diff):
        raise UserError("--unsafe-fixes says which edits, and goes with --fix or --diff", hint="--fix --unsafe-fixes")
    if task:
        from xpl_cli.audit.physics.simulation import check_tasks

        check_tasks(task)
    targets = _select_targets(
        paths or (), changed_since, every=every, is_run=set(gate or ()) != {Gate.STATIC}, demos=demos
    )
    sandbox.check([target.path for target in targets], memory_limit=memory_limit, isolate=isolate)
    gates = tuple(Gate(name) for name in _GATES if not gate or name in gate)
    with progress() as say:
        options = AuditOptions(
            gates=gates,
            names=tuple(selected),
            ignore=tuple(ignored),
            keep_going=keep_going,
            overrides=package.parse_overrides(settings),
            python=python,
            env=policy_env,
            profile=Profile(profile) if profile else None,
            memory_limit=memory_limit,
            isolate=isolate,
            time_limit=TimeLimit.parse(time_limit),
            patience=patience,
            tasks=tuple(task),
            episodes=episodes,
            move=move,
            demos=demos,
            pictures=pictures,
            video=video,
            cache=None if no_cache else cache.default_folder(),
            progress=say,
        )
        plan = None
        if fix or diff:
            from xpl_cli.audit.engine.fixes import plan_all

            plan = plan_all(targets, options, unsafe=unsafe_fixes)
        if plan is not None and not diff:
            plan.apply()
        reports = [] if diff else audit_all(targets, options)
    if plan is not None:
        console.note(plan.summary(done=not diff))
    if plan is not None and diff:
        if plan.changes:
            console.data(plan.diff())
        raise typer.Exit(int(bool(plan.changes)))
    context = ReportContext(
        fail_on=Outcome(fail_on),
        selection=(
            *_option_words("--select", selected),
            *_option_words("--ignore", ignored),
            *(("--keep-going",) if keep_going else ()),
            *(() if fail_on == Outcome.FAIL else ("--fail-on", fail_on)),
            *(("--profile", profile) if profile else ()),
            *(("--isolate",) if isolate else ()),
            *_option_words("--task", task),
            *_option_words("--episodes", [str(episodes)] if episodes else []),
        ),
        running=(
            *_option_words("--set", settings),
            *_option_words("--python", [python] if python else []),
            *_option_words("--policy-env", [policy_env] if policy_env else []),
        ),
        demonstrations=_option_words("--demos", [str(demos)] if demos else []),
    )
    delivery.deliver(reports, context)
    raise typer.Exit(int(exit_code(reports, Outcome(fail_on))))


def _check_demos(demos: Path | None, targets: Sequence[AuditTarget]) -> None:
    """Check `--demos`: the path must exist, and exactly one policy must be audited.

    Raises:
        UserError: otherwise.
    """
    from xpl_cli.basics.errors import ExitCode, UserError
    from xpl_cli.packages.package import POLICY

    if demos is None:
        return
    if not demos.exists():
        raise UserError(f"there are no demonstrations at {demos}", code=ExitCode.NOT_FOUND)
    if [target.kind for target in targets] != [POLICY]:
        raise UserError(f"--demos is for one policy, and {len(targets)} packages were named", hint="audit it alone")


def _select_targets(
    paths: Iterable[Path], changed_since: str | None, *, every: bool, is_run: bool, demos: Path | None
) -> list[AuditTarget]:
    """Return the packages to audit: all selected ones, or those of them that changed since a commit.

    Prints a note for each waiver that names a retired rule.
    """
    from xpl_cli.audit.engine import waivers
    from xpl_cli.audit.static.source import Source
    from xpl_cli.basics import console
    from xpl_cli.packages.targets import requested_targets

    targets = requested_targets(paths, every=every)
    _check_demos(demos, targets)
    if changed_since is not None:
        from xpl_cli.audit.engine.changed import select_changed

        targets = select_changed(changed_since, targets, is_run=is_run)
    for line in (line for target in targets for line in waivers.notes(Source(target.path))):
        console.note(line)
    return targets


def _parse_profile(name: str | None, *, shadow: bool) -> str | None:
    """Return the profile of `--profile` and `--shadow`, or None."""
    from xpl_cli.basics.errors import UserError

    if not shadow:
        return name
    if name not in {None, _PROFILES[1]}:
        raise UserError(f"--shadow and --profile {name} contradict each other: give one of them")
    return _PROFILES[1]


def _option_words(option: str, values: list[str]) -> tuple[str, ...]:
    """Return the words of an option with its values, for commands that repeat it."""
    return tuple(part for value in values for part in (option, value))
