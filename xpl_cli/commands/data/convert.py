"""`xpl data convert`: demonstrations in another format."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.endings import ends
from xpl_cli.commands.data.listing import SET
from xpl_cli.commands.options import JSON


@ends(
    clean="converted",
    usage="usage, or the target is there already",
    findings="they are damaged",
    not_found="no demonstrations there",
    not_run="the format cannot hold them, or a library is missing",
)
def convert(
    demonstrations: Path = SET,
    target: Path = typer.Argument(..., metavar="DST", help="File or folder that is made."),
    to: str = typer.Option(..., "--to", metavar="FORMAT", help="Format; an unknown one lists them."),
    by: str | None = typer.Option(
        None, "--map", metavar="MAPPING", help="What the field's side means: libero, aloha, robotwin, or a file."
    ),
    written_by: str | None = typer.Option(
        None, "--as", metavar="MAPPING", help="The same for the result, where both sides are the field's."
    ),
    rate: float | None = typer.Option(None, min=0.001, help="Steps per second, where the set does not say them."),
    robot: str | None = typer.Option(None, help="What the robot is called, where the set does not say it."),
    images: str = typer.Option("auto", help="How cameras are kept: auto, video, png, jpeg or raw."),
    codec: str = typer.Option("av1", help="Codec of videos: av1 or h264."),
    crf: int = typer.Option(30, min=0, max=63, help="Quality of videos; smaller is better and larger."),
    file_mb: float | None = typer.Option(None, min=1.0, help="Size of a file that joins episodes."),
    workers: int | None = typer.Option(None, min=1, help="Processes; as many as there are cores by default."),
    as_json: bool = JSON,
) -> None:
    """Convert demonstrations; the same command goes on where an earlier one was interrupted."""
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import one_of
    from xpl_cli.basics.progress import progress
    from xpl_cli.data.conversion import job as conversion
    from xpl_cli.data.formats.writers import writer_of
    from xpl_cli.data.formats.writing import IMAGES, VIDEO, WriteOptions

    options = WriteOptions(one_of("--images", images, IMAGES), one_of("--codec", codec, VIDEO), crf, file_mb)
    job = conversion.ConversionJob(
        demonstrations, target, writer_of(to).name, rate, robot, by, written_by, options, workers
    )
    with progress() as reporter:
        report = conversion.convert(job, reporter)
    if as_json:
        console.answer("xpl.data-convert/1", report.data, [f"xpl data list {target}"])
    else:
        console.data(report.text)
