"""The `model_io` block, and other manifest keys, of what was read from a checkpoint."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.adopt.checkpoints import cameras, layout
from xpl_cli.adopt.facts import Evidence, Fact, Tree, UnknownFact, certain, likely, plain

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.embodiment import Embodiment
    from xpl_cli.adopt.checkpoints.trained_model import ImageSpec, TrainedModel, VectorSpec

_KEYS = {
    "joints": sdk.State.ARM_JOINT_STATE,
    "position": sdk.State.EE_POSE,
    "rotation": sdk.State.EE_POSE,
    "gripper": sdk.State.EE_JOINT_STATE,
    "hand": sdk.State.EE_JOINT_STATE,
}


@dataclass(frozen=True)
class UserChoices:
    """The user's choices, which take precedence over what is read.

    Attributes:
        gripper: values of the closed and the open gripper.
        cameras: the standard's camera, by the dataset's or the model's name.
        statistics: entry of the statistics file, where it has several datasets.
    """

    gripper: tuple[float, float] | None = None
    cameras: Mapping[str, str] = field(default_factory=dict)
    statistics: str | None = None


def model_io(trained: TrainedModel, robot: Embodiment | None, choices: UserChoices) -> Tree:
    """Return the block as a tree of facts."""
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
        _set_part_references(action["parts"], robot, trained)
    block["action"] = {**action, "reference": trained.reference, **trained.extra}
    block["sampling"] = trained.sampling
    if trained.recurrent is not None:
        block["recurrent"] = trained.recurrent
    if trained.code:
        block["code"] = list(trained.code)
    return block


def temporal(trained: TrainedModel) -> Tree:
    """Return the manifest's `temporal`."""
    chunk, history = trained.chunk, trained.history
    if trained.recurrent is not None and plain(trained.recurrent):
        kind: Tree = "memory"
    elif history is not None:
        kind = "history"
    else:
        kind = "single_step" if isinstance(chunk, Fact) and chunk.value == 1 else "chunk"
    tree: dict[str, Tree] = {
        "kind": kind,
        "chunk": replace(chunk, placeholder=1) if isinstance(chunk, UnknownFact) else chunk,
    }
    if history is not None:
        length = history["length"]
        tree["history"] = replace(length, placeholder=1) if isinstance(length, UnknownFact) else length
    if trained.ensembling is not None:
        tree["ensembling"] = trained.ensembling
    return tree


def inputs(block: Mapping[str, Tree], robot: Embodiment | None) -> dict[str, list[str]]:
    """Return the manifest's `inputs`: those that the block reads, and those that it does not."""
    camera_names = [name for view in block.get("images", ()) for name in _as_list(view["cameras"])]
    parts = [part for state in block.get("state", ()) for part in _as_list(state["parts"])]
    keys = dict.fromkeys(_KEYS[kind] for part in parts for kind in part if kind in _KEYS)
    required = [
        *(f"{sdk.Obs.STATE}.{key}" for key in keys),
        *(f"{sdk.Obs.VISION}.{name}" for name in dict.fromkeys(camera_names)),
    ]
    text = block.get(sdk.Obs.INSTRUCTION)
    optional: list[str] = []
    if text is not None:
        (optional if plain(text).get("empty") == "blank" else required).append(sdk.Obs.INSTRUCTION)
    usual = cameras.standard_cameras(len(robot.arms))[:-1] if robot else ()
    unused = [f"{sdk.Obs.VISION}.{name}" for name in usual if name not in camera_names]
    return {
        "required": required,
        "optional": optional,
        "unused": [*unused, *([sdk.Obs.INSTRUCTION] if text is None else [])],
    }


def camera_sizes(trained: TrainedModel, block: Mapping[str, Tree]) -> dict[str, dict[str, Any]]:
    """Return the manifest's `cameras`: the training size of each, null where any size works."""
    result: dict[str, dict[str, Any]] = {}
    sizes = {str(plain(view.input)): view.size for view in trained.views}
    for entry in block.get("images", ()):
        height, width = sizes[str(plain(entry["input"]))] or (None, None)
        for name in _as_list(entry["cameras"]):
            result.setdefault(name, {"width": width, "height": height})
    return result


def _set_part_references(parts: list[Tree], robot: Embodiment, trained: TrainedModel) -> None:
    """Set the reference of each part of an action that differs from that of the whole."""
    offset = 0
    arms = dict(zip(layout.sides(robot), robot.arms, strict=True))
    for part in parts:
        ((kind, how),) = part.items()
        arm = arms[plain(how["arm"])]
        width = arm.dof if kind == "joints" else arm.ee_dim
        exempt = set(trained.exempt[offset : offset + width])
        offset += width
        if len(exempt) > 1:
            how["reference"] = UnknownFact("some of its numbers are deltas, and some are not")
        elif exempt == {True} and kind == "joints":
            how["reference"] = "absolute"
        elif exempt == {False} and kind == "gripper":
            how["reference"] = trained.reference


def _as_list(tree: Tree) -> list[Any]:
    """Return the entries of a list, or of a fact with a list; empty for an unknown value."""
    value = tree.value if isinstance(tree, Fact) else tree
    return value if isinstance(value, list) else []


def _views(trained: TrainedModel, robot: Embodiment | None, choices: UserChoices) -> list[Tree]:
    flat = [(name, view) for view in trained.views for name in view.names]
    if robot is None:
        camera_facts: list[Fact | UnknownFact] = [
            UnknownFact(f"which camera {name!r} is: the robot is not known") for name, _ in flat
        ]
    else:
        arms = len(robot.arms)
        camera_facts = [_camera_of(name, view, arms, choices) for name, view in flat]
        camera_facts = cameras.without_duplicates(camera_facts, [name for name, _ in flat])
    by_name = iter(camera_facts)
    result: list[Tree] = []
    for view in trained.views:
        own = [next(by_name) for _ in view.names]
        if view.optional and any(isinstance(camera, UnknownFact) for camera in own):
            continue
        entry: dict[str, Tree] = {"input": view.input, "cameras": _merge_cameras(own)}
        if view.steps:
            entry["steps"] = list(view.steps)
        result.append({**entry, **view.rest})
    return result


def _camera_of(name: str, view: ImageSpec, arms: int, choices: UserChoices) -> Fact | UnknownFact:
    model = plain(view.input)
    for alias in (name, name.rpartition(".")[2], name.rpartition("/")[2], *([model] if len(view.names) == 1 else [])):
        if alias in choices.cameras:
            return certain([choices.cameras[alias]], Evidence("", None, "given with --camera"))
    return cameras.standard_camera(name, arms, view.evidence)


def _merge_cameras(own: list[Fact | UnknownFact]) -> Fact | UnknownFact:
    if unknown := [camera for camera in own if isinstance(camera, UnknownFact)]:
        return UnknownFact(
            "; ".join(camera.reason for camera in unknown),
            tuple(evidence for camera in unknown for evidence in camera.evidence),
        )
    facts = [camera for camera in own if isinstance(camera, Fact)]
    if len(facts) == 1:
        return facts[0]
    names = [name for camera in facts for name in camera.value]
    return likely(names, *(evidence for camera in facts for evidence in camera.evidence))


def _vector(vector: VectorSpec, robot: Embodiment | None, choices: UserChoices) -> dict[str, Tree]:
    entry: dict[str, Tree] = {} if vector.input is None else {"input": vector.input}
    if vector.parts is None:
        entry["parts"] = layout.parts(vector.numbers, robot, choices.gripper)
    elif callable(vector.parts):
        entry["parts"] = (
            UnknownFact("the robot is not known") if robot is None else vector.parts(robot, choices.gripper)
        )
    else:
        entry["parts"] = vector.parts
    if vector.normalize is not None:
        entry["normalize"] = vector.normalize
    if vector.pad is not None:
        entry["pad"] = vector.pad
    return entry
