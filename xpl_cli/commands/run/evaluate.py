"""`xpl eval`: run episodes of one adapter in one environment."""

from __future__ import annotations

import contextlib
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from xpl_cli.commands import values
from xpl_cli.commands.options import (
    EVAL_ENV,
    ISOLATE,
    JSON,
    POLICY,
    POLICY_ENV,
    POLICY_GPU,
    PRIVILEGED_HELP,
    PYTHON,
    SETTINGS,
)
from xpl_cli.commands.run import hand_over

if TYPE_CHECKING:
    from xpl_cli.evaluation.runs import evaluate as suite
    from xpl_cli.evaluation.runs import quick_eval


def evaluate(
    policy: str = POLICY,
    env: str | None = typer.Option(None, "--env", help="Environment package; default: EVAL_ENV_TYPE."),
    task: str | None = typer.Option(None, help="Task, A,B, a split or all; default: deploy.yml's."),
    setting: str | None = typer.Option(None, help="Setting, with --out also A,B or all; default: first."),
    episodes: int | None = typer.Option(None, min=1, help="Episodes of each task and setting; default: 1."),
    num_envs: int | None = typer.Option(None, min=1, help="Environments per batch; default: one per worker."),
    workers: str = typer.Option(
        "1",
        metavar="N|auto",
        help="Rollout workers: N, 0 (none) or auto.",
    ),
    horizon: int | None = typer.Option(
        None,
        min=1,
        help="Execution horizon; default: deploy.py's loop.",
    ),
    seed: int | None = typer.Option(
        None,
        min=0,
        help="First seed or, with --out, its index.",
    ),
    out: Path | None = typer.Option(None, metavar="DIR", help="Folder to record the run in.", rich_help_panel="Record"),
    resume: bool = typer.Option(False, "--resume", help="Continue the run in --out.", rich_help_panel="Record"),
    until_width: float | None = typer.Option(
        None,
        metavar="W",
        help="End a task when its 95 % interval is at most W wide.",
        rich_help_panel="Record",
    ),
    servers: int | None = typer.Option(
        None,
        min=1,
        help="Policy servers; default: one per worker or GPU.",
        rich_help_panel="Servers and machines",
    ),
    film: int = typer.Option(
        1,
        min=0,
        metavar="N",
        help="Film N episodes per task and setting.",
        rich_help_panel="Record",
    ),
    record: Path | None = typer.Option(
        None,
        "--record",
        metavar="DIR",
        help="Folder for the trajectories (HDF5).",
        rich_help_panel="Record",
    ),
    keep: str | None = typer.Option(
        None, metavar="all|success", help="Trajectories to save; default: all.", rich_help_panel="Record"
    ),
    privileged: bool = typer.Option(False, "--privileged", help=PRIVILEGED_HELP, rich_help_panel="Record"),
    backend: str = typer.Option(
        "local",
        metavar="NAME",
        help="local, or ray (a cluster).",
        rich_help_panel="Servers and machines",
    ),
    policy_gpus: float = typer.Option(
        0.0, min=0.0, help="Cluster GPUs per policy server.", rich_help_panel="Servers and machines"
    ),
    instruction: str | None = typer.Option(
        None,
        metavar="blank|swap",
        help="Ablation: no or a wrong instruction (--out).",
        rich_help_panel="Record",
    ),
    connect: str | None = typer.Option(
        None,
        callback=values.address,
        metavar="URL",
        help="Use a running policy server at ws://host:port.",
        rich_help_panel="Servers and machines",
    ),
    token_file: Path | None = typer.Option(
        None, metavar="FILE", help="Bearer token for --connect.", rich_help_panel="Servers and machines"
    ),
    ca_file: Path | None = typer.Option(
        None,
        callback=values.certificates,
        metavar="FILE",
        help="Certificate authority for --connect wss://...",
        rich_help_panel="Servers and machines",
    ),
    settings: list[str] = SETTINGS,
    info: str | None = typer.Option(
        None,
        metavar="K=V,...",
        help="Like --set for each K=V, as launchers write it.",
        rich_help_panel="Adapter",
    ),
    policy_env: str | None = POLICY_ENV,
    eval_env: str | None = EVAL_ENV,
    policy_gpu: str | None = POLICY_GPU,
    isolate: bool = ISOLATE,
    env_gpu: str | None = typer.Option(
        None,
        help="Ignored; launchers pass it.",
        rich_help_panel="Environment process",
    ),
    python: str | None = PYTHON,
    as_json: bool = JSON,
) -> None:
    """Run rollouts in an environment; report success rate and score."""
    from xpl import _spec as spec
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import UserError
    from xpl_cli.evaluation.rollout import config, trajectory_recorder
    from xpl_cli.evaluation.runs import quick_eval, remote
    from xpl_cli.evaluation.runs.settings import environment_for, with_robot
    from xpl_cli.packages import package
    from xpl_cli.serving.secrets import read_token

    overrides = package.parse_overrides([*(part for part in (info or "").split(",") if part), *settings])
    if seed is not None:
        overrides[spec.Deploy.SEED] = seed
    token = None if token_file is None else read_token(token_file)
    remote_server = None if connect is None else remote.RemoteServer(connect, token, ca_file)
    is_here = _is_here(policy)
    if is_here:
        from xpl_cli.evaluation.hand_over.request import HandOverRequest

        unfit = {
            "--setting": setting,
            "--num-envs": num_envs,
            "--horizon": horizon,
            "--until-width": until_width,
            "--instruction": instruction,
            "--token-file": token_file,
            "--ca-file": ca_file,
            "--isolate": isolate or None,
        }
        env, is_done = hand_over.try_hand_over(
            policy,
            env,
            overrides,
            unfit,
            partial(
                HandOverRequest,
                task=task,
                episodes=episodes or 1,
                out=out,
                resume=resume,
                connect=connect,
                python=python,
                env=policy_env,
                gpu=policy_gpu,
                eval_env=eval_env,
                env_gpu=env_gpu or "0",
            ),
            as_json=as_json,
        )
        if is_done:
            return
    recording = trajectory_recorder.recording_config(record, keep, resume=resume, privileged=privileged)
    announcement = (
        None
        if remote_server is None or (out is None and is_here)
        else remote.fetch_announcement(remote_server, overrides)
    )
    adapter = remote.resolve_package(policy, announcement, overrides)
    _check_instruction(instruction, is_recorded=out is not None)
    if horizon is None and not is_here:
        console.note(f"{adapter.name} is not here, and so its evaluation loop is not: ours executes whole chunks")
        horizon = remote.WHOLE_CHUNK
    if env_gpu is not None:
        console.note(f"--env-gpu {env_gpu} is for launchers that start a simulator; the environments here need none")
    if out is not None:
        from xpl_cli.basics.errors import NotFoundError
        from xpl_cli.evaluation.records import records
        from xpl_cli.evaluation.rollout import backends
        from xpl_cli.evaluation.rollout.backend import BackendConfig
        from xpl_cli.evaluation.runs import evaluate as suite
        from xpl_cli.evaluation.runs import plan

        if resume and not (out / records.FILE).exists():
            raise NotFoundError(f"{out} holds no recorded run to go on with", hint="without --resume it begins one")
        said = {task, setting, episodes, until_width, None if horizon == remote.WHOLE_CHUNK else horizon}
        is_silent = not overrides and said == {None} and instruction is None
        is_batch = (num_envs or 1) > 1
        plan_request: plan.PlanRequest | None = plan.PlanRequest(
            task, setting, episodes, int(adapter.config(overrides)[spec.Deploy.SEED]), horizon, until_width
        )
        if is_silent:
            plan_request = (
                None if horizon is None or (out / records.FILE).exists() else plan.PlanRequest(horizon=horizon)
            )
        _run_recorded_eval(
            suite.EvalRequest(
                package=adapter,
                environment=env,
                out=out,
                plan_request=plan_request,
                resume=resume,
                backend_config=BackendConfig(
                    backend, 1 if is_batch else backends.parse_workers(workers), servers, policy_gpus
                ),
                films=film,
                overrides=overrides if env is None else with_robot(adapter, env, overrides),
                runtime=config.Runtime(python, policy_env, policy_gpu, eval_env, isolate),
                remote=remote_server,
                announced=announcement,
                num_envs=num_envs,
                env_workers=quick_eval.num_envs_and_workers(num_envs, workers)[1] if is_batch else 1,
                recording=recording,
                instruction=instruction,
            ),
            as_json=as_json,
        )
        return
    if resume or until_width is not None or backend != "local":
        raise UserError(
            "--resume, --until-width and --backend are for a run that is recorded: name its folder with --out"
        )
    environments, processes = quick_eval.num_envs_and_workers(num_envs, workers)
    env = env or environment_for()
    _run_quick_eval(
        quick_eval.QuickEvalRequest(
            package=adapter,
            environment=env,
            task=task,
            setting=setting,
            episodes=episodes or 1,
            num_envs=environments,
            workers=processes,
            horizon=horizon,
            overrides=with_robot(adapter, env, overrides),
            remote=remote_server,
            runtime=config.Runtime(python, policy_env, policy_gpu, eval_env, isolate),
            recording=recording,
        ),
        policy,
        as_json=as_json,
    )


def _check_instruction(instruction: str | None, *, is_recorded: bool) -> None:
    """Raise if the instruction cannot be replaced."""
    if instruction is None:
        return
    from xpl_cli.basics.errors import UserError
    from xpl_cli.environments.rollout import choose_name
    from xpl_cli.evaluation.records.run_mode import INSTRUCTIONS

    choose_name("instruction", instruction, list(INSTRUCTIONS))
    if not is_recorded:
        raise UserError("--instruction is for a run that is recorded: name its folder with --out")


def _is_here(policy: str) -> bool:
    """Return whether there is an adapter of this name or at this path."""
    from xpl_cli.basics.errors import NotFoundError
    from xpl_cli.packages import package

    try:
        package.find_policy(policy)
    except NotFoundError:
        return False
    return True


def questions_for(environment: str | None) -> contextlib.AbstractContextManager[object]:
    """Return a context that serves questions to the operator, if the environment may be a robot."""
    from xpl_cli.packages import environments

    if environment is None or not environments.manifest(environments.find(environment)).is_real:
        return contextlib.nullcontext()
    from xpl_cli.environments.operator_questions import serve_questions

    return serve_questions()


def _run_recorded_eval(request: suite.EvalRequest, *, as_json: bool) -> None:
    """Run what a recorded run lacks, and print its summary."""
    import shlex

    from xpl_cli.basics import console
    from xpl_cli.evaluation.runs import evaluate as suite
    from xpl_cli.evaluation.statistics import summary, wording
    from xpl_cli.standard import spec as standard

    with questions_for(request.environment):
        run = suite.evaluate(request)
    report = summary.summarise(run)
    if as_json:
        console.data_json({**report.as_json(), "next": [shlex.join(["xpl", "report", str(request.out)])]})
    else:
        console.data(wording.text(report))
    suite.check_complete(run)
    if not as_json:
        console.data(standard.data("package")["eval_finish_line"])


def _run_quick_eval(request: quick_eval.QuickEvalRequest, policy: str, *, as_json: bool) -> None:
    """Evaluate and print the result; `policy` is the adapter as the user named it."""
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import ExitCode, UserError
    from xpl_cli.basics.progress import progress
    from xpl_cli.evaluation.runs import quick_eval
    from xpl_cli.standard import spec as standard

    with questions_for(request.environment), progress() as say:
        evaluation = quick_eval.evaluate(request, say)
    if as_json:
        console.data_json({**evaluation.as_json(), "next": evaluation.following(policy)})
        if evaluation.infrastructure_errors:
            raise typer.Exit(ExitCode.NOT_RUN)
        return
    console.data(evaluation.text())
    if evaluation.infrastructure_errors:
        count = len(evaluation.episodes)
        raise UserError(
            f"{evaluation.infrastructure_errors} of {count} episodes ended with an infrastructure error and have no "
            "result",
            code=ExitCode.NOT_RUN,
        )
    console.data(standard.data("package")["eval_finish_line"])
