"""`xpl new-policy --from`: an adapter from a training's checkpoint; `xpl adopt` shares its options."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from xpl import _spec as sdk
from xpl_cli.commands.scaffold import new_package

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl_cli.adopt.checkpoints.block import UserChoices
    from xpl_cli.adopt.checkpoints.package_start import NewPackage

GRIPPER = typer.Option(
    None, metavar="CLOSED,OPEN", help="With --from: the model's values of a closed and of an open gripper."
)
CAMERA = typer.Option(
    [], metavar="NAME=CAMERA", help="With --from: a camera of the checkpoint and its name in the standard."
)
STATISTICS = typer.Option(
    None, metavar="NAME", help="With --from: whose statistics count, where a file holds those of several data sets."
)

_SCHEMA = "xpl.new-policy/1"
_TAKEN = "the checkpoint says it"


def begin(
    name: str,
    paths: Sequence[Path],
    parent: Path,
    options: Mapping[str, Any],
    *,
    overwrite: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Write a package that runs a checkpoint, and report known and unknown values.

    Args:
        name: of the package.
        paths: folders of the checkpoint and of its data set.
        parent: folder that the package goes into.
        options: `embodiment`, `action_type`, `gripper` and `cameras_named`; every other one that is given is refused.
        overwrite: replace files that differ.
        dry_run: only say what would be written.
        as_json: print a JSON object.

    Raises:
        UserError: if an option does not fit, or the folders hold nothing that is known.
    """
    from xpl_cli.adopt.checkpoints import package_start
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import UserError

    known = ("embodiment", sdk.Deploy.ACTION_TYPE, "gripper", "camera", "statistics")
    refused = [f"--{option.replace('_', '-')}" for option in options if option not in known]
    if refused:
        raise UserError(
            f"{', '.join(refused)} {'does' if len(refused) == 1 else 'do'} not go with --from: {_TAKEN}",
            hint="leave them out; what it does not say can be changed in policy.yml afterwards",
        )
    said = choices(options.get("gripper"), options.get("camera") or (), options.get("statistics"), given=True)
    wanted = package_start.StartOptions(name, options.get("embodiment"), options.get(sdk.Deploy.ACTION_TYPE), said)
    begun = package_start.new_package(paths, wanted)
    target = parent / name
    state = new_package.put(begun.files, target, overwrite=overwrite, dry_run=dry_run)
    if not dry_run:
        begun.link(target)
    for note in begun.notes:
        console.note(f"note: {note}")
    following = _next(target, begun)
    new_package.report(
        begun.files, target, state, following, schema=_SCHEMA, as_json=as_json, facts=_facts(begun), lines=_tell(begun)
    )


def choices(gripper: str | None, cameras: Sequence[str], statistics: str | None, *, given: bool) -> UserChoices:
    """Return the user's options on a checkpoint.

    Args:
        gripper: values of a closed and of an open gripper, as in 0,1.
        cameras: each as in top=cam_head.
        statistics: which entry of a file of statistics counts.
        given: whether there is a checkpoint.

    Raises:
        UserError: if an option is not written so, or there is no checkpoint that it could be said of.
    """
    from xpl_cli.adopt.checkpoints.block import UserChoices
    from xpl_cli.basics.errors import UserError

    if not given and (gripper or cameras or statistics):
        message = "--gripper, --camera and --statistics complete the facts of a checkpoint"
        raise UserError(message, hint="give its folder with --from")
    return UserChoices(_gripper(gripper), _cameras(cameras), statistics)


def _tell(begun: NewPackage) -> list[str]:
    found = begun.findings
    counted = {**found.counts, "open": len(found.unknown)}
    counts = ", ".join(f"{count} {word}" for word, count in counted.items())
    return [
        f"read from {begun.folder}: {counts}",
        *(f"  open  {key}: {leaf.text}" for key, leaf in found.unknown.items()),
    ]


def _facts(begun: NewPackage) -> dict[str, Any]:
    return {
        "checkpoint": begun.checkpoint,
        "from": str(begun.folder),
        "facts": begun.findings.facts_as_json(),
        "open": begun.findings.unknown_as_json(),
        "notes": begun.notes,
    }


def _next(target: Path, begun: NewPackage) -> list[str]:
    """Return the next commands for pasting."""
    import shlex

    from xpl_cli.model_io.names import CODE

    path = shlex.quote(str(target))
    record = [f"xpl model-io record {path}"] if CODE in begun.files else []
    return [f"xpl install {path}", *record, f"xpl audit {path}"]


def _gripper(text: str | None) -> tuple[float, float] | None:
    """Return the values of a closed and of an open gripper.

    Raises:
        UserError: if they are not two numbers that differ.
    """
    from xpl_cli.basics.errors import UserError

    if text is None:
        return None
    try:
        closed, opened = (float(part) for part in text.split(","))
    except ValueError:
        closed = opened = 0.0
    if not (abs(closed) < float("inf") and abs(opened) < float("inf")) or closed == opened:
        what = "the model's values of a closed and of an open gripper, as in 0,1"
        raise UserError(f"--gripper takes {what}; got {text!r}")
    return closed, opened


def _cameras(given: Sequence[str]) -> dict[str, str]:
    """Return the mapping of the data's camera names to those of the standard.

    Raises:
        UserError: if one is not written NAME=CAMERA.
    """
    from xpl_cli.basics.errors import UserError

    result: dict[str, str] = {}
    for entry in given:
        name, equals, camera = entry.rpartition("=")
        if not equals or not name or not camera:
            what = "the checkpoint's name and the standard's, as in top=cam_head"
            raise UserError(f"--camera takes {what}; got {entry!r}")
        result[name] = camera
    return result
