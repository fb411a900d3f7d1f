"""Makes the block `model_io`, and what else a manifest says of a model, of what was read from a checkpoint."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.adopt.checkpoints import cameras, layout
from xpl_cli.adopt.facts import Evidence, Open, Told, Tree, certain, likely, plain

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.embodiment import Embodiment
    from xpl_cli.adopt.checkpoints.trained import Trained, Vector, View

_KEYS = {
    "joints": sdk.State.ARM_JOINT_STATE,
    "position": sdk.State.EE_POSE,
    "rotation": sdk.State.EE_POSE,
    "gripper": sdk.State.EE_JOINT_STATE,
    "hand": sdk.State.EE_JOINT_STATE,
}


@dataclass(frozen=True)
class Choices:
    """What the user said, which outranks what is read.

    Attributes:
        gripper: values of a closed and of an open gripper.
        cameras: the data's or the model's name of a camera to the standard's.
        statistics: which entry of a file of statistics counts, where it holds those of several data sets.
    """

    gripper: tuple[float, float] | None = None
    cameras: Mapping[str, str] = field(default_factory=dict)
    statistics: str | None = None


def model_io(trained: Trained, robot: Embodiment | None, choices: Choices) -> Tree:
    """Return the block as a tree of values with their sources."""
    block: dict[str, Tree] = {}
    views = _views(trained, robot, choices)
    if views:
        block["images"] = views
    states = [_vector(state, robot, choices) for state in trained.states]
    if states:
        block["state"] = states
    if trained.instruction is not None:
        block[sdk.Obs.INSTRUCTION] = trained.instruction
    if trained.history is not None:
        block["history"] = trained.history
    action = _vector(trained.action, robot, choices)
    if trained.exempt and robot is not None and isinstance(action["parts"], list):
        _exempt(action["parts"], robot, trained)
    block["action"] = {**action, "reference": trained.reference, **trained.extra}
    block["sampling"] = trained.sampling
    if trained.recurrent is not None:
        block["recurrent"] = trained.recurrent
    if trained.code:
        block["code"] = list(trained.code)
    return block


def temporal(trained: Trained) -> Tree:
    """Return `temporal` of the manifest."""
    chunk, history = trained.chunk, trained.history
    if trained.recurrent is not None and plain(trained.recurrent):
        kind: Tree = "memory"
    elif history is not None:
        kind = "history"
    else:
        kind = "single_step" if isinstance(chunk, Told) and chunk.value == 1 else "chunk"
    tree: dict[str, Tree] = {"kind": kind, "chunk": replace(chunk, stand_in=1) if isinstance(chunk, Open) else chunk}
    if history is not None:
        length = history["length"]
        tree["history"] = replace(length, stand_in=1) if isinstance(length, Open) else length
    if trained.ensembling is not None:
        tree["ensembling"] = trained.ensembling
    return tree


def inputs(block: Mapping[str, Tree], robot: Embodiment | None) -> dict[str, list[str]]:
    """Return `inputs` of the manifest: what the block reads, and what it leaves aside."""
    shown = [name for view in block.get("images", ()) for name in _of(view["cameras"])]
    parts = [part for state in block.get("state", ()) for part in _of(state["parts"])]
    keys = dict.fromkeys(_KEYS[kind] for part in parts for kind in part if kind in _KEYS)
    required = [
        *(f"{sdk.Obs.STATE}.{key}" for key in keys),
        *(f"{sdk.Obs.VISION}.{name}" for name in dict.fromkeys(shown)),
    ]
    text = block.get(sdk.Obs.INSTRUCTION)
    optional: list[str] = []
    if text is not None:
        (optional if plain(text).get("empty") == "blank" else required).append(sdk.Obs.INSTRUCTION)
    usual = cameras.known(len(robot.arms))[:-1] if robot else ()
    unused = [f"{sdk.Obs.VISION}.{name}" for name in usual if name not in shown]
    return {
        "required": required,
        "optional": optional,
        "unused": [*unused, *([sdk.Obs.INSTRUCTION] if text is None else [])],
    }


def smallest(trained: Trained, block: Mapping[str, Tree]) -> dict[str, dict[str, Any]]:
    """Return `cameras` of the manifest: the size that each was trained on, null where any will do."""
    result: dict[str, dict[str, Any]] = {}
    sizes = {str(plain(view.input)): view.size for view in trained.views}
    for entry in block.get("images", ()):
        height, width = sizes[str(plain(entry["input"]))] or (None, None)
        for name in _of(entry["cameras"]):
            result.setdefault(name, {"width": width, "height": height})
    return result


def _exempt(parts: list[Tree], robot: Embodiment, trained: Trained) -> None:
    """Say of each part of an action what it is counted from, where that is not the whole's."""
    place = 0
    arms = dict(zip(layout.sides(robot), robot.arms, strict=True))
    for part in parts:
        ((kind, how),) = part.items()
        arm = arms[plain(how["arm"])]
        width = arm.dof if kind == "joints" else arm.ee_dim
        kept = set(trained.exempt[place : place + width])
        place += width
        if len(kept) > 1:
            how["reference"] = Open("some of its numbers are deltas, and some are not")
        elif kept == {True} and kind == "joints":
            how["reference"] = "absolute"
        elif kept == {False} and kind == "gripper":
            how["reference"] = trained.reference


def _of(tree: Tree) -> list[Any]:
    """Return the entries of a list that may be open."""
    found = tree.value if isinstance(tree, Told) else tree
    return found if isinstance(found, list) else []


def _views(trained: Trained, robot: Embodiment | None, choices: Choices) -> list[Tree]:
    flat = [(name, view) for view in trained.views for name in view.names]
    if robot is None:
        shown: list[Told | Open] = [Open(f"which camera {name!r} is: the robot is not known") for name, _ in flat]
    else:
        arms = len(robot.arms)
        shown = [_chosen(name, view, arms, choices) for name, view in flat]
        shown = cameras.without_twins(shown, [name for name, _ in flat])
    by_name = iter(shown)
    result: list[Tree] = []
    for view in trained.views:
        own = [next(by_name) for _ in view.names]
        if view.optional and any(isinstance(camera, Open) for camera in own):
            continue
        entry: dict[str, Tree] = {"input": view.input, "cameras": _together(own)}
        if view.steps:
            entry["steps"] = list(view.steps)
        result.append({**entry, **view.rest})
    return result


def _chosen(name: str, view: View, arms: int, choices: Choices) -> Told | Open:
    model = plain(view.input)
    for word in (name, name.rpartition(".")[2], name.rpartition("/")[2], *([model] if len(view.names) == 1 else [])):
        if word in choices.cameras:
            return certain([choices.cameras[word]], Evidence("", None, "given with --camera"))
    return cameras.standard_camera(name, arms, view.evidence)


def _together(own: list[Told | Open]) -> Told | Open:
    if unknown := [camera for camera in own if isinstance(camera, Open)]:
        return Open(
            "; ".join(camera.reason for camera in unknown), tuple(seen for camera in unknown for seen in camera.seen)
        )
    told = [camera for camera in own if isinstance(camera, Told)]
    if len(told) == 1:
        return told[0]
    names = [name for camera in told for name in camera.value]
    return likely(names, *(seen for camera in told for seen in camera.evidence))


def _vector(vector: Vector, robot: Embodiment | None, choices: Choices) -> dict[str, Tree]:
    entry: dict[str, Tree] = {} if vector.input is None else {"input": vector.input}
    if vector.parts is None:
        entry["parts"] = layout.parts(vector.numbers, robot, choices.gripper)
    elif callable(vector.parts):
        entry["parts"] = Open("the robot is not known") if robot is None else vector.parts(robot, choices.gripper)
    else:
        entry["parts"] = vector.parts
    if vector.normalize is not None:
        entry["normalize"] = vector.normalize
    if vector.pad is not None:
        entry["pad"] = vector.pad
    return entry
