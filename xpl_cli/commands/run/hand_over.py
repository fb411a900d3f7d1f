"""`xpl env hand-over`: let a benchmark's own launcher evaluate a policy, and record its result."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands import values
from xpl_cli.commands.options import JSON, POLICY, POLICY_ENV, POLICY_GPU, PYTHON, SETTINGS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from xpl.contract import Config
    from xpl_cli.evaluation.hand_over.request import HandOverRequest

_ANSWER = "xpl.env-hand-over/1"


@exit_codes(
    clean="the launcher ended, and its result was read",
    not_found="environment, adapter, task or workspace not found",
    not_run="the launcher failed, or its result cannot be relied on",
)
def hand_over(
    name: str = typer.Argument(..., metavar="NAME", help="Environment package whose env.yml declares a launcher."),
    policy: str = POLICY,
    task: str | None = typer.Option(None, help="Task of the benchmark; deploy.yml's or the first by default."),
    episodes: int = typer.Option(1, min=1, help="Number of episodes; a benchmark may have fewer."),
    seed: int | None = typer.Option(None, min=0, help="Seed as the benchmark counts; deploy.yml's by default."),
    workspace: Path | None = typer.Option(
        None, metavar="DIR", help="Folder of the benchmark; default: its environment variable."
    ),
    rehearse: bool = typer.Option(False, "--rehearse", help="Run the fake benchmark instead, without results."),
    out: Path | None = typer.Option(None, metavar="DIR", help="Record the run there."),
    resume: bool = typer.Option(False, "--resume", help="Go on with the run in --out."),
    connect: str | None = typer.Option(
        None, callback=values.address, metavar="URL", help="Use a server that already runs at ws://host:port."
    ),
    dry_run: bool = typer.Option(False, "--dry-run", help="Print the command line, and start nothing."),
    settings: list[str] = SETTINGS,
    policy_env: str | None = POLICY_ENV,
    policy_gpu: str | None = POLICY_GPU,
    python: str | None = PYTHON,
    eval_env: str | None = typer.Option(
        None, help="Environment whose python the launcher finds first, as for --policy-env."
    ),
    env_gpu: str = typer.Option("0", help="Device of the simulator, for the launcher."),
    hours: float = typer.Option(72.0, min=0.001, help="End the launcher after so long."),
    as_json: bool = JSON,
) -> None:
    """Evaluate a policy with a benchmark's own launcher: serve it, call the launcher, read its result back."""
    from xpl import _spec as spec
    from xpl_cli.basics import console
    from xpl_cli.evaluation.hand_over import launch as engine
    from xpl_cli.evaluation.hand_over.request import HandOverRequest
    from xpl_cli.packages import package

    overrides = package.parse_overrides(settings)
    if seed is not None:
        overrides[spec.Deploy.SEED] = seed
    request = HandOverRequest(
        package=package.load(policy, overrides),
        environment=name,
        task=task,
        episodes=episodes,
        workspace=workspace,
        rehearse=rehearse,
        out=out,
        resume=resume,
        connect=connect,
        overrides=overrides,
        python=python,
        env=policy_env,
        gpu=policy_gpu,
        eval_env=eval_env,
        env_gpu=env_gpu,
        hours=hours,
    )
    if not dry_run:
        play(request, as_json=as_json)
        return
    command = engine.make_plan(request).words("localhost", "PORT")
    if as_json:
        console.answer(_ANSWER, {"environment": name, "policy": policy, "command": command})
    else:
        console.data(shlex.join(command))


def play(request: HandOverRequest, *, as_json: bool) -> None:
    """Run the launcher and print the result."""
    from dataclasses import asdict

    from xpl_cli.basics import console
    from xpl_cli.evaluation.hand_over import launch as engine
    from xpl_cli.standard import spec as standard

    answer = engine.hand_over(request)
    recorded = request.out is not None and answer.episodes is not None
    if as_json:
        console.answer(_ANSWER, asdict(answer), [shlex.join(["xpl", "report", str(request.out)])] if recorded else [])
        return
    console.data(answer.text())
    console.data(standard.data("package")["eval_finish_line"])


def try_hand_over(
    policy: str,
    environment: str | None,
    overrides: Config,
    unfit: Mapping[str, object],
    request: Callable[..., HandOverRequest],
    *,
    as_json: bool,
) -> tuple[str | None, bool]:
    """Hand over instead of evaluating, if the environment is a mock and the benchmark's workspace is configured.

    Args:
        policy: the adapter, as the user named it.
        environment: as the user named it; None for that of the benchmark in deploy.yml, if one here has its task.
        overrides: of deploy.yml.
        unfit: options that the launcher does not support, with their values.
        request: makes the request from `package`, `environment` and `overrides`.
        as_json: whether the answer is a JSON object.

    Returns:
        the environment, if one was named or found, and whether it was handed over to.

    Raises:
        UserError: it was, and an option is not supported.
    """
    import os

    from xpl_cli.basics import console
    from xpl_cli.basics.errors import UserError
    from xpl_cli.evaluation.hand_over.launcher import Launcher
    from xpl_cli.evaluation.runs.settings import benchmark_for
    from xpl_cli.packages import environments, package

    adapter = package.load(policy, overrides)
    name = environment or benchmark_for(adapter.config(overrides))
    if name is None:
        return None, False
    facts = environments.manifest(environments.find(name))
    is_replaced = facts.hand_over is not None and facts.stand_in is not None
    if is_replaced and os.environ.get(Launcher.read(facts).entry.workspace.variable):
        unsupported = [option for option, value in unfit.items() if value is not None]
        if unsupported:
            raise UserError(
                f"{name} runs in its own workspace, by its own launcher, which does not support {unsupported[0]}"
            )
        play(request(package=adapter, environment=name, overrides=overrides), as_json=as_json)
        return name, True
    if facts.stand_in is not None:
        console.note(f"{name}: {facts.stand_in}")
    return name, False
