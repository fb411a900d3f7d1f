"""`xpl record`: demonstrations of an environment's expert, of a policy, or of a person."""

from __future__ import annotations

import shlex
from pathlib import Path

import typer

from xpl_cli.basics.endings import ends
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

_IMAGES = "HxW of all cameras, `own` for the environment's sizes, or `none`; what the policy reads, or own, by default."


@ends(
    clean="the set is complete",
    findings="fewer episodes than wanted",
    not_found="environment, task or player not found",
)
def record(
    env: str = typer.Argument(..., metavar="ENV", help="Environment package, or its folder."),
    out: Path = typer.Option(..., "--out", metavar="DIR", help="Folder of the set."),
    task: str | None = typer.Option(None, help="Task; the first by default. Also A,B, a split, or all."),
    episodes: int = typer.Option(50, min=1, help="Episodes to keep, of each task."),
    policy: str | None = typer.Option(
        None, "--policy", metavar="POLICY", help="Adapter that plays; the environment's expert by default."
    ),
    embodiment: str | None = typer.Option(None, help="Embodiment; the first of the task by default."),
    setting: str | None = typer.Option(None, help="Setting; the first by default."),
    action_type: str | None = typer.Option(None, help="Control; the first by default."),
    seed: int = typer.Option(0, min=0, help="Where seeds begin; evaluation seeds are left out."),
    keep: str | None = typer.Option(
        None,
        metavar="success|all",
        help="Which are kept; of an expert those that succeed, of others all by default.",
        rich_help_panel="What is kept",
    ),
    images: str | None = typer.Option(None, metavar="HxW", help=_IMAGES, rich_help_panel="What is kept"),
    form: str = typer.Option(
        "jpeg",
        metavar="FORM",
        help="How images are stored: jpeg, jpeg-padded, png or raw.",
        rich_help_panel="What is kept",
    ),
    quality: int = typer.Option(95, min=1, max=95, help="Of JPEGs.", rich_help_panel="What is kept"),
    no_depth: bool = typer.Option(False, "--no-depth", help="Leave depth out.", rich_help_panel="What is kept"),
    privileged: bool = typer.Option(False, "--privileged", help=PRIVILEGED_HELP, rich_help_panel="What is kept"),
    horizon: int | None = typer.Option(
        None,
        min=1,
        help="Actions of a chunk to execute, by our own loop; without it deploy.py's loop runs.",
        rich_help_panel="Adapter",
    ),
    film: int = typer.Option(
        0, min=0, metavar="N", help="Film the first N episodes of each task.", rich_help_panel="What is kept"
    ),
    workers: str = typer.Option("1", metavar="N|auto", help="Episodes at once; auto: one a core."),
    resume: bool = typer.Option(False, "--resume", help="Go on with the set in --out; it may also grow so."),
    settings: list[str] = SETTINGS,
    policy_env: str | None = POLICY_ENV,
    eval_env: str | None = EVAL_ENV,
    policy_gpu: str | None = POLICY_GPU,
    isolate: bool = ISOLATE,
    python: str | None = PYTHON,
    as_json: bool = JSON,
) -> None:
    """Record demonstrations as trajectories (HDF5). They are played on seeds that no evaluation uses."""
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
    """Return the size of images that is asked for.

    Raises:
        UserError: it is none.
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
