"""`xpl serve`: run the policy server of one adapter."""

from __future__ import annotations

import typer

POLICY = typer.Argument(..., metavar="POLICY", help="Folder of the adapter, or its name below policy/.")
SETTINGS = typer.Option([], "--set", metavar="KEY=VALUE", help="Override a key of deploy.yml; the value is YAML.")
POLICY_ENV = typer.Option(
    None, "--policy-env", "--env", metavar="ENV", help="conda:NAME, uv:DIR, venv:DIR or none (this interpreter)."
)


def serve(
    policy: str = POLICY,
    settings: list[str] = SETTINGS,
    host: str | None = typer.Option(None, help="Address to listen on; deploy.yml's by default."),
    port: int | None = typer.Option(None, help="TCP port; 0 lets the system choose."),
    python: str | None = typer.Option(None, help="Interpreter that runs the adapter."),
    policy_env: str | None = POLICY_ENV,
    gpu: str | None = typer.Option(None, help="Device made visible to the adapter."),
    insecure: bool = typer.Option(False, "--insecure", help="Allow an address other than loopback."),
    debug: bool = typer.Option(False, "--debug", help="Send tracebacks to clients."),
    until_stdin_ends: bool = typer.Option(
        False, "--until-stdin-ends", help="End when standard input ends, for whoever starts servers."
    ),
) -> None:
    """Serve a policy until interrupted; prints one JSON line on stdout when it is ready."""
    from xpl import _spec as spec
    from xpl_cli import package
    from xpl_cli.serving.run import run_server

    overrides = package.parse_overrides(settings)
    if host is not None:
        overrides[spec.Deploy.HOST] = host
    if port is not None:
        overrides[spec.Deploy.PORT] = port
    run_server(
        package.load(policy),
        overrides,
        python=python,
        env=policy_env,
        gpu=gpu,
        insecure=insecure,
        debug=debug,
        until_stdin_ends=until_stdin_ends,
    )
