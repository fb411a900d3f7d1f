"""`xpl data show`: an episode as a page, a picture or a Rerun recording."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.data.listing import SET
from xpl_cli.commands.options import JSON


@exit_codes(
    clean="written",
    findings="they are damaged",
    not_found="no demonstrations or no episode there",
    not_run="a library is missing",
)
def show(
    demonstrations: Path = SET,
    episode: str = typer.Option("0", metavar="K", help="Episode: its index, from 0, or its key."),
    out: Path | None = typer.Option(
        None, "-o", "--out", metavar="FILE", help="A page (.html) or a picture (.png); SET-K.html by default."
    ),
    frames: int = typer.Option(8, min=1, max=64, help="Frames of each camera."),
    rerun: Path | None = typer.Option(None, metavar="FILE", help="Write an .rrd for Rerun's viewer too."),
    as_json: bool = JSON,
) -> None:
    """Show an episode: camera frames, and plots of states and actions."""
    from xpl_cli.basics import console
    from xpl_cli.basics.atomic import write_file
    from xpl_cli.basics.errors import UserError
    from xpl_cli.data.reading import open_set
    from xpl_cli.data.show import page, sheet
    from xpl_cli.data.show.episode_view import find_episode, view
    from xpl_cli.data.show.rerun import write

    dataset = open_set(demonstrations)
    recorded = find_episode(dataset, episode)
    target = out or Path(f"{demonstrations.resolve().stem}-{recorded.key.replace('/', '-')}.html")
    if target.suffix.lower() not in (".html", ".png"):
        raise UserError(f"-o takes a file .html or .png, got {target.name}")
    if rerun is not None:
        write(dataset, recorded, rerun)
    episode_view = view(dataset, recorded, frames)
    if target.suffix.lower() == ".png":
        import io

        stream = io.BytesIO()
        sheet.draw(episode_view).save(stream, "PNG")
        write_file(target, stream.getvalue())
    else:
        write_file(target, page.render(episode_view).encode())
    written = [str(target), *([str(rerun)] if rerun is not None else [])]
    if as_json:
        document = {"files": written, "path": episode_view.path, "key": episode_view.key, "steps": episode_view.steps}
        console.answer("xpl.data-show/1", document, [])
    else:
        console.data("\n".join(written))
