"""`xpl install`, `xpl prepare` and `xpl train`: what the scripts of an adapter call."""

from __future__ import annotations

import typer

from xpl_cli.commands.serve import POLICY, SETTINGS

_GPU = typer.Option(None, help="Device made visible to the script.")


def install(policy: str = POLICY) -> None:
    """Make the interpreter that policy.yml declares for an adapter; prints its path."""
    from xpl_cli import console, lifecycle, package

    console.data(lifecycle.install(package.load(policy)))


def prepare(policy: str = POLICY, settings: list[str] = SETTINGS) -> None:
    """Run an adapter's process_data.py with the configuration of a run."""
    from xpl_cli import lifecycle, package

    lifecycle.run_script(package.load(policy), "process_data.py", package.parse_overrides(settings))


def train(policy: str = POLICY, settings: list[str] = SETTINGS, gpu: str | None = _GPU) -> None:
    """Run an adapter's train.py with the configuration of a run."""
    from xpl_cli import lifecycle, package

    overrides = {**lifecycle.gpu_setting(gpu), **package.parse_overrides(settings)}
    lifecycle.run_script(package.load(policy), "train.py", overrides, gpu)
