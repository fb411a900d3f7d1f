"""`xpl eval`: run episodes of one adapter in one environment."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.commands.serve import POLICY, POLICY_ENV, SETTINGS


def evaluate(
    policy: str = POLICY,
    env: str | None = typer.Option(None, "--env", help="Environment package; EVAL_ENV_TYPE decides by default."),
    task: str | None = typer.Option(None, help="Task of the environment; deploy.yml's or the first by default."),
    episodes: int = typer.Option(1, min=1, help="Number of episodes."),
    num_envs: int = typer.Option(1, min=1, help="Environments at once, in one batch."),
    seed: int | None = typer.Option(None, help="Seed of the first episode; deploy.yml's by default."),
    connect: str | None = typer.Option(None, metavar="URL", help="Use a server that already runs at ws://host:port."),
    token_file: Path | None = typer.Option(None, metavar="FILE", help="Bearer token for --connect."),
    ca_file: Path | None = typer.Option(None, metavar="FILE", help="Certificate authority for --connect wss://..."),
    settings: list[str] = SETTINGS,
    info: str | None = typer.Option(None, metavar="K=V,...", help="Further overrides in the launchers' form."),
    policy_env: str | None = typer.Option(None, "--policy-env", metavar="ENV", help=POLICY_ENV.help),
    eval_env: str | None = typer.Option(None, help="Environment of the simulator; ours need none."),
    policy_gpu: str | None = typer.Option(None, help="Device made visible to the adapter."),
    env_gpu: str | None = typer.Option(None, help="Device of the simulator; ours need none."),
    python: str | None = typer.Option(None, help="Interpreter that runs the adapter."),
    as_json: bool = typer.Option(False, "--json", help="Print a JSON object."),
) -> None:
    """Serve a policy, run episodes in an environment, and report success and score."""
    from xpl import _spec as spec
    from xpl_cli import console, evaluation, package
    from xpl_cli import spec as standard
    from xpl_cli.errors import ExitCode, UserError
    from xpl_cli.progress import progress
    from xpl_cli.secrets import client_tls_context, read_token

    for option, value in (("--eval-env", eval_env), ("--env-gpu", env_gpu)):
        if value is not None:
            console.note(f"{option} {value} is for launchers that start a simulator; the environments here need none")
    overrides = package.parse_overrides([*(part for part in (info or "").split(",") if part), *settings])
    if seed is not None:
        overrides[spec.Deploy.SEED] = seed
    request = evaluation.Request(
        package=package.load(policy),
        environment=env or evaluation.environment_for(),
        task=task,
        episodes=episodes,
        num_envs=num_envs,
        overrides=overrides,
        connect=connect,
        token=None if token_file is None else read_token(token_file),
        ssl_context=None if ca_file is None else client_tls_context(ca_file),
        python=python,
        env=policy_env,
        gpu=policy_gpu,
    )
    with progress() as say:
        report = evaluation.evaluate(request, say)
    if as_json:
        console.data_json(report)
        if report["infrastructure_failures"]:
            raise typer.Exit(ExitCode.NOT_RUN)
        return
    control = report[spec.Deploy.ACTION_TYPE]
    played = f"{report['environment']}/{report['task']}, {report['embodiment']}, {control} control"
    where = f"{report['policy']} on {played}"
    count = len(report["episodes"])
    if report["success_rate"] is None:
        console.data(f"{where}: {count} episodes ran to their end in {report['seconds']:.1f} s")
    else:
        score = f"mean score {report['mean_score']:.2f}"
        console.data(f"{where}: {report['successes']} of {count} succeeded, {score}, {report['seconds']:.1f} s")
    failed = report["infrastructure_failures"]
    if failed:
        raise UserError(
            f"{failed} of {count} trials were spoilt by the infrastructure and count neither way", code=ExitCode.NOT_RUN
        )
    console.data(standard.data("package")["eval_finish_line"])
