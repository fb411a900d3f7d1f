"""`xpl serve`: run the policy server of one adapter."""

from __future__ import annotations

from pathlib import Path

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
    gpu: list[str] = typer.Option([], metavar="ID", help="Device made visible; workers take several in turn."),
    workers: int = typer.Option(1, metavar="N", help="Copies of the model: N clients are served at once."),
    token_file: Path | None = typer.Option(None, metavar="FILE", help="Ask clients for the bearer token in FILE."),
    tls_cert: Path | None = typer.Option(None, metavar="FILE", help="Serve wss:// with this certificate (PEM)."),
    tls_key: Path | None = typer.Option(None, metavar="FILE", help="Key of the certificate, if it is in another file."),
    insecure: bool = typer.Option(False, "--insecure", help="Listen elsewhere than on loopback without a token."),
    debug: bool = typer.Option(False, "--debug", help="Send tracebacks to clients."),
    metrics: bool = typer.Option(False, "--metrics", help="Offer /metrics in Prometheus' format on the same port."),
    trace: Path | None = typer.Option(None, metavar="FILE", help="Append one JSON line for each request to FILE."),
    until_stdin_ends: bool = typer.Option(
        False, "--until-stdin-ends", help="End when standard input ends, for whoever starts servers."
    ),
) -> None:
    """Serve a policy until interrupted; prints one JSON line on stdout when it is ready."""
    from xpl import _spec as spec
    from xpl_cli import package
    from xpl_cli.serving.run import Options, run_server

    overrides = package.parse_overrides(settings)
    if host is not None:
        overrides[spec.Deploy.HOST] = host
    if port is not None:
        overrides[spec.Deploy.PORT] = port
    options = Options(
        python=python,
        env=policy_env,
        gpu=gpu,
        workers=workers,
        token_file=token_file,
        tls_cert=tls_cert,
        tls_key=tls_key,
        insecure=insecure,
        debug=debug,
        metrics=metrics,
        trace=trace,
        until_stdin_ends=until_stdin_ends,
    )
    run_server(package.load(policy), overrides, options)
