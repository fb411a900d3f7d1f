"""`xpl new-policy`: an adapter package that runs at once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from xpl_cli.commands.options import JSON
from xpl_cli.commands.scaffold import from_checkpoint, new_package
from xpl_cli.commands.scaffold.from_checkpoint import CAMERA, GRIPPER, STATISTICS

if TYPE_CHECKING:
    from collections.abc import Callable

_SCHEMA = "xpl.new-policy/1"


def new_policy(
    name: str = typer.Argument(..., metavar="NAME", help="Name of the policy, and of its folder."),
    parent: Path = typer.Option(Path("policy"), "--dir", metavar="DIR", help="Folder that the package goes into."),
    embodiment: str | None = typer.Option(None, help="Robot; `xpl spec show` lists them."),
    action_type: str | None = typer.Option(None, metavar="joint|ee", help="Joint or end-effector control."),
    chunk: int | None = typer.Option(None, help="Action steps that one call returns."),
    family: str | None = typer.Option(None, help="Kind of policy: vla, diffusion, act, ..."),
    eval_only: bool = typer.Option(False, "--eval-only", help="Leave out data processing and training."),
    kind: str | None = typer.Option(
        None,
        metavar="KIND",
        help="What it is built on: minimal (numpy alone), torch, lerobot or remote.  [default: minimal]",
    ),
    history: int | None = typer.Option(None, metavar="N", help="Observations that are kept per environment."),
    ensembling: float | None = typer.Option(
        None, metavar="DECAY", help="Average overlapping chunks, as ACT does with 0.01; 0 weighs all alike."
    ),
    cameras: str | None = typer.Option(
        None, metavar="NAME,...", help="Cameras that it reads, with the smallest image: cam_head:640x480, or any size."
    ),
    code: bool = typer.Option(
        False, "--code", help="Convert in encode and decode, not by the model_io block of policy.yml."
    ),
    reference: bool = typer.Option(
        False, "--reference", help="Also write reference.py, by which the adapter is compared with the model."
    ),
    python: str | None = typer.Option(None, help="The policy's own Python: a version, or the path of an interpreter."),
    sources: list[Path] = typer.Option(
        [],
        "--from",
        metavar="FOLDER",
        help="Folder of a checkpoint whose facts fill policy.yml; once more for the data set it was trained on.",
    ),
    gripper: str | None = GRIPPER,
    camera: list[str] = CAMERA,
    statistics: str | None = STATISTICS,
    overwrite: bool = typer.Option(False, "--overwrite", help="Replace files that differ; files of your own are kept."),
    dry_run: bool = typer.Option(False, "--dry-run", help="Only say what would be written."),
    as_json: bool = JSON,
) -> None:
    """Scaffold an adapter from the standard. It runs at once; `xpl audit` lists what you have to fill in."""
    from xpl_cli.packages import robots
    from xpl_cli.scaffold import adapter

    embodiment = robots.canonical_name(embodiment, parent / name)
    if sources:
        adapter.check_name(name)
        given = _given(
            embodiment=embodiment,
            action_type=action_type,
            gripper=gripper,
            camera=camera or None,
            statistics=statistics,
            chunk=chunk,
            family=family,
            eval_only=eval_only or None,
            kind=kind,
            history=history,
            ensembling=ensembling,
            cameras=cameras,
            code=code or None,
            reference=reference or None,
            python=python,
        )
        from_checkpoint.begin(name, sources, parent, given, overwrite=overwrite, dry_run=dry_run, as_json=as_json)
        return
    from_checkpoint.choices(gripper, camera, statistics, given=False)
    chosen = _given(
        embodiment=embodiment,
        action_type=action_type,
        chunk=chunk,
        family=family,
        eval_only=eval_only or None,
        python=python,
        kind=kind,
        history=history,
        ensembling=ensembling,
        cameras=[name.strip() for name in cameras.split(",")] if cameras else None,
        block=False if code else None,
        reference=reference or None,
    )
    if not as_json and not dry_run and _can_prompt():
        adapter.check_name(name)
        chosen.update(_ask(chosen))
    answers = adapter.answers_of(name=name, **{**adapter.defaults(), **chosen})
    adapter.check(answers)

    files = adapter.render(answers)
    target = parent / name
    state = new_package.put(files, target, overwrite=overwrite, dry_run=dry_run)
    following = _next(target, install=adapter.needs_environment(answers))
    new_package.report(files, target, state, following, schema=_SCHEMA, as_json=as_json)


def _given(**options: Any) -> dict[str, Any]:
    return {question: answer for question, answer in options.items() if answer is not None}


def _next(target: Path, *, install: bool) -> list[str]:
    """Return the next commands for pasting."""
    import shlex

    path = shlex.quote(str(target))
    return [*([f"xpl install {path}"] if install else []), f"xpl audit {path}"]


def _can_prompt() -> bool:
    """Tell whether a user at a terminal can be prompted."""
    import os
    import sys

    return sys.stdin.isatty() and sys.stdout.isatty() and not os.environ.get("CI")


def _ask(given: dict[str, Any]) -> dict[str, Any]:
    """Prompt the user for missing values."""
    from xpl_cli.scaffold import adapter

    suggested, allowed = adapter.defaults(), adapter.choices()
    return {
        question: typer.prompt(
            f"{question} ({', '.join(names)})", default=suggested[question], value_proc=_one_of(names), err=True
        )
        for question, names in allowed.items()
        if question not in given
    }


def _one_of(names: list[str]) -> Callable[[str], str]:
    def read(answer: str) -> str:
        if answer not in names:
            raise typer.BadParameter(f"expected one of {', '.join(names)}, got {answer!r}")
        return answer

    return read
