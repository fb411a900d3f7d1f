"""`xpl record`: record demonstrations of a scripted expert, of a policy or by teleoperation."""

from __future__ import annotations

import shlex
from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.options import (
    EVAL_ENV,
    ISOLATE,
    JSON,
    POLICY_ENV,
    POLICY_GPU,
    PRIVILEGED_HELP,
    PYTHON,
    SETTINGS,
)
from xpl_cli.commands.run.evaluate import questions_for

_IMAGES = "Size, own or none; default: the policy's or own."


@exit_codes(
    clean="the set is complete",
    findings="fewer episodes than requested",
    not_found="environment, task or policy not found",
)
def record(
    env: str = typer.Argument(..., metavar="ENV", help="Environment package, or its folder."),
    out: Path = typer.Option(..., "--out", metavar="DIR", help="Folder of the demonstrations."),
    task: str | None = typer.Option(None, help="Task, A,B, a split or all; default: the first."),
    episodes: int = typer.Option(50, min=1, help="Episodes to keep of each task."),
    policy: str | None = typer.Option(
        None, "--policy", metavar="POLICY", help="Adapter that acts; default: the scripted expert."
    ),
    embodiment: str | None = typer.Option(None, help="Embodiment; default: the task's first."),
    setting: str | None = typer.Option(None, help="Setting; default: the first."),
    action_type: str | None = typer.Option(None, help="Action type; default: the first."),
    seed: int = typer.Option(0, min=0, help="First seed, without evaluation seeds."),
    keep: str | None = typer.Option(
        None,
        metavar="success|all",
        help="Default: success for the expert, all for a policy.",
        rich_help_panel="Recording",
    ),
    images: str | None = typer.Option(None, metavar="HxW", help=_IMAGES, rich_help_panel="Recording"),
    form: str = typer.Option(
        "jpeg",
        metavar="FORM",
        help="jpeg, jpeg-padded, png or raw.",
        rich_help_panel="Recording",
    ),
    quality: int = typer.Option(95, min=1, max=95, help="JPEG quality.", rich_help_panel="Recording"),
    no_depth: bool = typer.Option(False, "--no-depth", help="Do not record depth.", rich_help_panel="Recording"),
    privileged: bool = typer.Option(False, "--privileged", help=PRIVILEGED_HELP, rich_help_panel="Recording"),
    horizon: int | None = typer.Option(
        None,
        min=1,
        help="Execution horizon; default: deploy.py's loop.",
        rich_help_panel="Adapter",
    ),
    film: int = typer.Option(0, min=0, metavar="N", help="Film N episodes per task.", rich_help_panel="Recording"),
    workers: str = typer.Option("1", metavar="N|auto", help="Rollout workers; auto: one per core."),
    resume: bool = typer.Option(False, "--resume", help="Continue the set in --out; --episodes may grow."),
    settings: list[str] = SETTINGS,
    policy_env: str | None = POLICY_ENV,
    eval_env: str | None = EVAL_ENV,
    policy_gpu: str | None = POLICY_GPU,
    isolate: bool = ISOLATE,
    python: str | None = PYTHON,
    as_json: bool = JSON,
) -> None:
    """Record demonstrations as trajectories (HDF5), on seeds that no evaluation uses."""
    from dataclasses import asdict

    from xpl.trajectory import FORMS
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import ExitCode
    from xpl_cli.basics.progress import progress
    from xpl_cli.environments.rollout import choose_name
    from xpl_cli.evaluation.rollout import backends, config
    from xpl_cli.evaluation.runs import collect, remote
    from xpl_cli.packages import package

    keep_choice = choose_name(
        "choice for --keep", keep or (config.SUCCESS if policy is None else config.ALL), config.KEEP
    )
    recording = config.RecordingConfig(
        str(out.absolute()), keep_choice, choose_name("form of images", form, FORMS), quality, not no_depth, privileged
    )
    request = collect.RecordRequest(
        environment=env,
        recording=recording,
        tasks=task,
        setting=setting,
        embodiment=embodiment,
        action_type=action_type,
        policy=policy,
        episodes=episodes,
        seed=seed,
        size=_size(images),
        horizon=remote.WHOLE_CHUNK if policy is None and horizon is None else horizon,
        films=film,
        workers=backends.parse_workers(workers),
        resume=resume,
        overrides=package.parse_overrides(settings),
        runtime=config.Runtime(python, policy_env, policy_gpu, eval_env, isolate),
    )
    with questions_for(env), progress() as say:
        result = collect.collect(request, say)
    if as_json:
        first = f"{result.folder}/episode_0000000.hdf5"
        console.answer("xpl.demonstrations/1", asdict(result), [shlex.join(["xpl", "spec", "validate", first])])
    else:
        console.data(result.text())
    if not result.is_complete:
        raise typer.Exit(ExitCode.FINDINGS)


def _size(images: str | None) -> tuple[int, int] | bool | None:
    """Return the requested size of images.

    Raises:
        UserError: it is invalid.
    """
    import re

    from xpl_cli.basics.errors import UserError

    if images is None:
        return None
    if images in ("own", "none"):
        return images == "own"
    match = re.fullmatch(r"([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", images)
    if match is None:
        raise UserError(f"--images must be HxW such as 128x128, own, or none, got {images!r}")
    return int(match[1]), int(match[2])
