"""`xpl data convert`: demonstrations in another format."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.data.listing import SET
from xpl_cli.commands.options import JSON


@exit_codes(
    clean="converted",
    usage="usage, or the target exists",
    findings="they are damaged",
    not_found="no demonstrations there",
    not_run="the format cannot hold them, or a library is missing",
)
def convert(
    demonstrations: Path = SET,
    target: Path = typer.Argument(..., metavar="DST", help="Output file or folder."),
    to: str = typer.Option(..., "--to", metavar="FORMAT", help="Output format: xpl or lerobot-v3.0."),
    by: str | None = typer.Option(
        None,
        "--map",
        metavar="MAPPING",
        help="Mapping of the side that is not xpl: libero, aloha, robotwin, or a file.",
    ),
    written_by: str | None = typer.Option(
        None, "--as", metavar="MAPPING", help="Mapping of the output, where neither side is xpl."
    ),
    rate: float | None = typer.Option(None, min=0.001, help="Steps per second, where the dataset has none."),
    robot: str | None = typer.Option(None, help="Name of the robot, where the dataset has none."),
    images: str = typer.Option("auto", help="Encoding of images: auto, video, png, jpeg or raw."),
    codec: str = typer.Option("av1", help="Codec of videos: av1 or h264."),
    crf: int = typer.Option(30, min=0, max=63, help="Constant rate factor of videos; smaller: better, larger files."),
    file_mb: float | None = typer.Option(None, min=1.0, help="Size at which episodes continue in another file, MB."),
    workers: int | None = typer.Option(None, min=1, help="Number of processes; default: CPU cores."),
    as_json: bool = JSON,
) -> None:
    """Convert demonstrations to another format; the same command resumes an interrupted conversion."""
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
