"""`xpl audit` and `xpl explain`."""

from __future__ import annotations

from pathlib import Path

import typer

_GATES = ("static", "offline", "mujoco")


def audit(
    paths: list[Path] = typer.Argument(..., metavar="PATH...", help="Folders of adapters or environments."),
    gate: list[str] = typer.Option([], "--gate", help="Run only this gate; may be repeated. static, offline, mujoco."),
    selected: list[str] = typer.Option([], "--select", help="Run only these rules: codes, code prefixes, slugs."),
    ignored: list[str] = typer.Option([], "--ignore", help="Leave these rules out."),
    report_format: str = typer.Option("human", "--format", help="human or json."),
    as_json: bool = typer.Option(False, "--json", help="The same as --format json."),
    keep_going: bool = typer.Option(False, "--keep-going", help="Run a gate although an earlier one failed."),
    settings: list[str] = typer.Option([], "--set", metavar="KEY=VALUE", help="Override a key of deploy.yml."),
    python: str | None = typer.Option(None, help="Interpreter that runs the adapter."),
    policy_env: str | None = typer.Option(None, "--policy-env", "--env", help="conda:NAME, uv:DIR, venv:DIR or none."),
) -> None:
    """Carry adapters through the static, the offline and the MuJoCo gate.

    Exit codes: 0 clean, 1 findings, 2 usage, 3 target not found, 4 a required check could not run, 5 internal error,
    130 interrupted.
    """
    from xpl_cli import console, package
    from xpl_cli.audit.engine import audit as run
    from xpl_cli.audit.model import Gate, exit_code
    from xpl_cli.audit.options import Options
    from xpl_cli.audit.report import as_json as to_json
    from xpl_cli.audit.report import as_text
    from xpl_cli.audit.targets import find_target
    from xpl_cli.errors import UserError
    from xpl_cli.progress import progress

    wanted = "json" if as_json else report_format
    if wanted not in ("human", "json"):
        raise UserError(f"--format is human or json, got {wanted!r}")
    for name in gate:
        if name not in _GATES:
            raise UserError(f"--gate is one of {', '.join(_GATES)}, got {name!r}")
    targets = [find_target(path) for path in paths]
    with progress() as say:
        options = Options(
            gates=tuple(Gate(name) for name in _GATES if not gate or name in gate),
            names=tuple(selected),
            ignore=tuple(ignored),
            keep_going=keep_going,
            overrides=package.parse_overrides(settings),
            python=python,
            env=policy_env,
            progress=say,
        )
        reports = [run(target.path, target.kind, options, shown=target.shown) for target in targets]
    if wanted == "json":
        console.data_json(to_json(reports))
    else:
        console.rich(as_text(reports))
    code = exit_code(reports)
    if code:
        raise typer.Exit(int(code))


def explain(
    name: str = typer.Argument(..., metavar="RULE", help="Code or slug of a rule, such as XPL101."),
    as_json: bool = typer.Option(False, "--json", help="Print a JSON object."),
) -> None:
    """Explain a rule: what it checks, why it matters, and what to do instead."""
    from xpl_cli import console, spec
    from xpl_cli.audit.registry import find

    rule = find(name)
    requirement = spec.requirements()[rule.requirement]
    if as_json:
        console.data_json(
            {
                "schema": "xpl.explain/1",
                "code": rule.code,
                "slug": rule.slug,
                "gate": rule.gate.value,
                "requirement": {"id": requirement.id, "level": requirement.level, "text": requirement.text},
                "severity": rule.severity,
                "documentation": rule.documentation,
            }
        )
        return
    from rich.markdown import Markdown

    proves = f"*{rule.gate} gate, proves {requirement.id} ({requirement.level}):* {requirement.text}"
    head = f"# {rule.code} {rule.slug}\n\n{proves}"
    console.rich(Markdown(f"{head}\n\n{rule.documentation}"))


def rules(as_json: bool = typer.Option(False, "--json", help="Print a JSON object.")) -> None:
    """List every rule with its code, gate, requirement and summary."""
    from xpl_cli import console
    from xpl_cli.audit.registry import rules as all_rules

    found = all_rules()
    if as_json:
        entries = [
            {
                "code": rule.code,
                "slug": rule.slug,
                "gate": rule.gate.value,
                "target": rule.target,
                "requirement": rule.requirement,
                "severity": rule.severity,
                "summary": rule.summary,
            }
            for rule in found
        ]
        console.data_json({"schema": "xpl.rules/1", "rules": entries, "next": ["xpl explain XPL101"]})
        return
    width = max(len(rule.slug) for rule in found)
    for rule in found:
        console.data(f"{rule.code}  {rule.slug:<{width}}  {rule.severity:<6}  {rule.summary}")
