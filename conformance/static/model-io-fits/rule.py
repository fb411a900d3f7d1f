"""XPL192: The block model_io is consistent with the robots, cameras and statistics of the package."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from xpl import _spec as sdk
from xpl import checkpoint, get_embodiment, robots
from xpl.contract import Entry
from xpl.convert import ConversionError, Interface, compile_interface
from xpl.convert.gaps import fill_gaps
from xpl.manifest import CameraNeeds
from xpl_cli.audit import Finding, Fix, NotApplicable, Proof, rule
from xpl_cli.audit.static.file_reading import resolve_inside
from xpl_cli.audit.static.manifests import location_in
from xpl_cli.audit.static.source import Source

_FILE, _BLOCK = sdk.File.POLICY_YML, "model_io"
_MOST_PIXELS = 2048


@rule(code="XPL192", requirement="XPL-NAT-1", after=("manifest",))
def model_io_fits(source: Source) -> Iterator[Finding | Proof]:
    """The block model_io of policy.yml is inconsistent with the rest of the manifest.

    ## What it does
    Compiles the conversions of `model_io` for every declared embodiment and action type, as the server does at its
    start, and converts images of the declared sizes. Statistics files in the package are read, and must have as many
    numbers as the vector. Inputs of the block have to be listed under `inputs`. None of the adapter's code runs.
    Unknown values and missing statistics are skipped; the JSON report counts the latter.

    ## Why it matters
    The adapter fails to start for that robot, or fails at the first observation.

    ## Example
    `embodiments: [franka]` and `parts: [{joints: {arm: single}}]`: franka has a left and a right arm.

    ## Use instead
    One part for each arm, in the model's order: `parts: [{joints: {arm: left}}, {joints: {arm: right}}]`. `xpl spec
    show model_io` lists every key and value.

    ## Fix safety
    No automatic fix.
    """
    if source.manifest.model_io is None:
        raise NotApplicable("policy.yml has no model_io block")
    model_io = source.manifest.model_io.data
    folders = _folders(source)
    lacking = _lacking(source, model_io, folders)
    yield from _outside(source, model_io)
    yield from _undeclared(source, model_io)
    reported: set[str] = set()
    manifest = source.manifest
    for robot, action_type in product(manifest.embodiments, manifest.action_types):
        if robot not in robots.names():  # which the rule on manifests reports
            continue
        try:
            embodiment = get_embodiment(robot)
            block = fill_gaps(model_io, embodiment, action_type, lacking)
            interface = compile_interface(block, embodiment, action_type, folders, manifest.temporal.chunk)
            _convert(interface, manifest.cameras, block)
        except ConversionError as error:
            if str(error) not in reported:
                reported.add(str(error))
                yield _finding(
                    source,
                    f"the policy fails on {robot} with {action_type} actions: {error}",
                    f"a block that matches {robot} and {action_type} actions",
                )
    yield Proof({"statistics_absent": len(lacking)})


def _convert(interface: Interface, cameras: Mapping[str, CameraNeeds], block: Entry) -> None:
    """Put black images of the declared sizes through a block.

    Raises:
        ConversionError: if they do not fit.
    """
    for image, entry in zip(interface.images, block.get("images", ()), strict=True):
        targets = [how["to"] for step in entry.get("steps", ()) for how in step.values() if "to" in _map(how)]
        needs = [cameras.get(name, CameraNeeds()) for name in image.cameras]
        sizes: list[Any] = [(need.height, need.width) for need in needs]
        numbers = [number for size in (*sizes, *targets) for number in size]
        if all(isinstance(number, int) and number <= _MOST_PIXELS for number in numbers):
            views = {
                name: {sdk.Camera.COLOR: np.zeros((*size, 3), np.uint8)}
                for name, size in zip(image.cameras, sizes, strict=True)
            }
            image.encode({sdk.Obs.VISION: views})


def _folders(source: Source) -> list[Path]:
    """Return where the statistics may lie, as `xpl.Policy` looks for them: the package, and its checkpoint."""
    try:
        return checkpoint.folders(source.deploy, source.path)
    except (OSError, ValueError, RuntimeError):  # a name that no file can have, or that nobody may look for
        return [source.path]


def _lacking(source: Source, model_io: Entry, folders: Sequence[Path]) -> list[str]:
    """Return the files of statistics that are not there, or that a link leads to out of the package."""
    here = source.path.resolve()
    named = dict.fromkeys(filter(None, map(_file, _vectors(model_io))))
    return [file for file in named if not any(resolve_inside(here, str(folder.resolve() / file)) for folder in folders)]


def _vectors(model_io: Entry) -> list[Entry]:
    return [*model_io.get("state", ()), model_io["action"]]


def _file(vector: Entry) -> str | None:
    return _map(vector.get("normalize")).get("file")


def _outside(source: Source, model_io: Entry) -> Iterator[Finding]:
    """Yield a finding for a file of statistics that is named by a path out of the package."""
    for file in dict.fromkeys(filter(None, map(_file, _vectors(model_io)))):
        if Path(file).is_absolute() or ".." in Path(file).parts:
            yield _finding(
                source,
                f"the statistics {file} lie outside of the package, where other users do not have them",
                "a path below the package or the checkpoint",
            )


def _undeclared(source: Source, model_io: Entry) -> Iterator[Finding]:
    """Yield a finding for all that the block reads and the manifest does not list."""
    listed = set(source.manifest.read)
    for name, path in dict(_read(model_io)).items():
        if name not in listed:
            yield Finding(
                f"the model_io block reads {name}, and the manifest does not list it: environments may not send it",
                **location_in(source, _FILE, (_BLOCK, *path)),
                expected=f"{name} under inputs.required or inputs.optional",
                got=", ".join(sorted(listed)) or "no input",
                fix=Fix("advice", f"list {name} under inputs.required, or remove it from the model_io block"),
            )


_DELTAS = ("delta_state", "delta_command", "cumulative")
_FIELDS = {
    "joints": sdk.State.ARM_JOINT_STATE,
    "gripper": sdk.State.EE_JOINT_STATE,
    "hand": sdk.State.EE_JOINT_STATE,
    "position": sdk.State.EE_POSE,
    "rotation": sdk.State.EE_POSE,
}


def _read(model_io: Entry) -> Iterator[tuple[str, tuple[str | int, ...]]]:
    """Yield the inputs of the manifest that the block reads, with the place that says so."""
    for index, image in enumerate(model_io.get("images", ())):
        for camera in image["cameras"] if isinstance(image["cameras"], list) else ():
            yield f"{sdk.Obs.VISION}.{camera}", ("images", index, "cameras")
    for index, vector in enumerate(model_io.get("state", ())):
        parts = vector["parts"] if isinstance(vector["parts"], list) else ()
        for number, kind in enumerate(kind for part in parts for kind in part):
            if kind in _FIELDS:
                yield f"{sdk.Obs.STATE}.{_FIELDS[kind]}", ("state", index, "parts", number)
    action = model_io["action"]
    for number, part in enumerate(action["parts"] if isinstance(action["parts"], list) else ()):
        for kind, how in part.items():
            counted_from = how.get("reference", "absolute" if kind == "gripper" else action["reference"])
            if kind in _FIELDS and counted_from in _DELTAS:
                yield f"{sdk.Obs.STATE}.{_FIELDS[kind]}", ("action", "parts", number)
    if model_io.get(sdk.Obs.INSTRUCTION) is not None:
        yield sdk.Obs.INSTRUCTION, (sdk.Obs.INSTRUCTION,)


def _map(value: object) -> Entry:
    return value if isinstance(value, Mapping) else {}


def _finding(source: Source, message: str, expected: str) -> Finding:
    return Finding(
        message,
        **location_in(source, _FILE, (_BLOCK,)),
        expected=expected,
        got="the model_io block",
        fix=Fix("command", "xpl spec show model_io"),
    )
