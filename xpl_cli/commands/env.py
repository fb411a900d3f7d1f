"""`xpl env`: what environments offer, whether their tasks hold, a picture, a film."""

from __future__ import annotations

from pathlib import Path

import typer

app = typer.Typer(help="List, check and look at environments.", no_args_is_help=True)

_NAME = typer.Argument(..., metavar="NAME", help="Environment package, or its folder.")
_TASK = typer.Option(None, help="Task; the first by default.")
_EMBODIMENT = typer.Option(None, help="Embodiment; the first by default.")
_SETTING = typer.Option(None, help="Setting; the first by default.")
_SEED = typer.Option(0, min=0, help="Seed of the episode.")
_CAMERA = typer.Option(None, help="Camera of env.yml; the view for people by default.")
_JSON = typer.Option(False, "--json", help="Print a JSON object.")


@app.command("list")
def list_(
    name: str | None = typer.Argument(None, metavar="[NAME]", help="One environment; all by default."),
    as_json: bool = _JSON,
) -> None:
    """List environments with their tasks, embodiments and settings."""
    from xpl_cli import console, env_list

    offers = env_list.offers(name)
    if as_json:
        console.data_json({"schema": env_list.SCHEMA, "environments": offers})
    else:
        console.data(env_list.text(offers))


@app.command()
def check(
    name: str = _NAME,
    task: list[str] = typer.Option([], help="Task; all by default. May be repeated."),
    embodiment: list[str] = typer.Option([], help="Embodiment; all by default. May be repeated."),
    setting: list[str] = typer.Option([], help="Setting; all by default. May be repeated."),
    episodes: int | None = typer.Option(None, min=1, help="Seeds of each task; all frozen ones by default."),
    action_type: str = typer.Option("joint", help="Control in which the expert plays."),
    as_json: bool = _JSON,
) -> None:
    """Play the frozen evaluation seeds: the expert must solve all, random actions none. Seeds are never replaced.

    Exit codes: 0 it holds, 1 it does not, 2 usage, 3 environment, task or seeds not found.
    """
    from xpl_cli import console, env_check
    from xpl_cli.errors import ExitCode
    from xpl_cli.progress import progress

    with progress() as say:
        report = env_check.check(name, env_check.Choice(task, embodiment, setting, episodes, action_type), say)
    if as_json:
        console.data_json(report)
    else:
        console.data(env_check.text(report))
    if not report["ok"]:
        raise typer.Exit(ExitCode.FINDINGS)


@app.command()
def render(
    name: str = _NAME,
    out: Path = typer.Argument(..., metavar="FILE.png", help="Picture to write."),
    task: str | None = _TASK,
    embodiment: str | None = _EMBODIMENT,
    setting: str | None = _SETTING,
    seed: int = _SEED,
    camera: str | None = _CAMERA,
) -> None:
    """Write what a camera sees when an episode begins."""
    from xpl_cli import console, env_film, env_play

    env_film.render(env_play.scenario(name, task, embodiment, setting), seed, camera, out)
    console.note(f"{out}: written")


@app.command()
def play(
    name: str = _NAME,
    out: Path = typer.Argument(..., metavar="FILE", help="Film to write: .webp, .gif or .png (animated)."),
    task: str | None = _TASK,
    embodiment: str | None = _EMBODIMENT,
    setting: str | None = _SETTING,
    seed: int = _SEED,
    camera: str | None = _CAMERA,
) -> None:
    """Write a film of the environment's expert, and say how the episode ended."""
    from xpl_cli import console, env_film, env_play

    result = env_film.film(env_play.scenario(name, task, embodiment, setting), seed, camera, out)
    console.data(f"{result['task']}: {result['end_reason']} after {result['steps']} steps, score {result['score']:.2f}")
    console.note(f"{out}: written")
