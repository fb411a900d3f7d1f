"""Generates reference.py for a checkpoint whose framework can be called: LeRobot's `select_action`.

It is generated from the facts, not from the block: audits compare the adapter with this second implementation. Each
convention has its source; without one it is `assumed`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.adopt.checkpoints import layout
from xpl_cli.adopt.checkpoints.frameworks.lerobot.types import CODE
from xpl_cli.adopt.facts import Confidence, Fact, Tree, UnknownFact, leaves, plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.contract import Entry
    from xpl.embodiment import Arm, Embodiment
    from xpl_cli.adopt.checkpoints.trained_model import TrainedModel


class UnknownFactError(Exception):
    """reference.py cannot be written; the message lists the unknown values."""


def context(trained: TrainedModel, block: Mapping[str, Tree], robot: Embodiment, checkpoint: str) -> dict[str, Any]:
    """Return the variables of the reference.py template.

    Args:
        trained: the model.
        block: its model_io block.
        robot: the robot.
        checkpoint: its name.

    Raises:
        UnknownFactError: a value is unknown, or a part is no joint, gripper or hand.
    """
    openings = [
        key
        for key, leaf in leaves({key: block[key] for key in ("images", "state", "action") if key in block}, "model_io")
        if isinstance(leaf, UnknownFact)
    ]
    if openings:
        raise UnknownFactError(f"{len(openings)} values are unknown: {', '.join(openings)}")
    state = block.get("state", [])
    if len(state) != 1:
        raise UnknownFactError(f"it has {len(state)} vector inputs, expected observation.state alone")
    return {
        "conventions": list(_conventions(trained, block, checkpoint)),
        "cameras": [_camera(entry) for entry in plain(block.get("images", []))],
        "state": list(_state_code(plain(state[0]["parts"]), robot)),
        "action": list(_action_code(plain(block["action"]["parts"]), robot)),
        "draws": plain(block["sampling"]) != "none",
    }


def _camera(entry: Entry) -> tuple[str, str, str]:
    size = next((step["resize"]["to"] for step in entry.get("steps", ()) if "resize" in step), [None, None])
    return entry["input"], entry["cameras"][0], f"({size[0]}, {size[1]})"


def _state_code(parts: Sequence[Entry], robot: Embodiment) -> Iterator[str]:
    """Yield the code of each part of the state vector."""
    for kind, how, arm in _parts_with_arms(parts, robot):
        key = arm.prefix + (sdk.State.ARM_JOINT_STATE if kind == "joints" else sdk.State.EE_JOINT_STATE)
        text = f'observed["{key}"]'
        if kind == "gripper":
            closed, opened = how["closed"], how["open"]
            if isinstance(closed, list):
                yield f"np.array({closed}) + {text} * (np.array({opened}) - np.array({closed}))"
            else:
                yield text if (closed, opened) == (0, 1) else f"{closed} + {text} * ({opened} - {closed})"
            continue
        if names := how.get("names"):
            text += f"[{[list(arm.joint_names or ()).index(name) for name in names]}]"
        yield f"np.degrees({text})" if how.get("unit") == "deg" else text


def _action_code(parts: Sequence[Entry], robot: Embodiment) -> Iterator[tuple[str, str]]:
    """Yield key and code of each field of an action step."""
    offset = 0
    for kind, how, arm in _parts_with_arms(parts, robot):
        key = arm.prefix + (sdk.State.ARM_JOINT_STATE if kind == "joints" else sdk.State.EE_JOINT_STATE)
        if kind == "gripper":
            if isinstance(how["closed"], list):
                raise UnknownFactError("the action has a gripper of several numbers")
            text = f"row[{offset}:{offset + 1}]"
            offset += 1
            if (how["closed"], how["open"]) != (0, 1):
                text = f"({text} - {how['closed']}) / ({how['open']} - {how['closed']})"
            yield key, f"np.clip({text}, 0.0, 1.0)"
            continue
        width = arm.dof if kind == "joints" else arm.ee_dim
        text = f"row[{offset}:{offset + width}]"
        offset += width
        if names := how.get("names"):
            text += f"[{[names.index(name) for name in arm.joint_names or ()]}]"
        yield key, f"np.radians({text})" if how.get("unit") == "deg" else text


def _parts_with_arms(parts: Sequence[Entry], robot: Embodiment) -> Iterator[tuple[str, Entry, Arm]]:
    arms: dict[str, Arm] = dict(zip(layout.sides(robot), robot.arms, strict=True))
    for part in parts:
        ((kind, how),) = part.items()
        if kind not in ("joints", "gripper", "hand"):
            raise UnknownFactError(
                f"a vector holds a {kind}, which has to be written by hand: LeRobot has no term for it"
            )
        yield kind, how, arms[how["arm"]]


def _conventions(trained: TrainedModel, block: Mapping[str, Tree], checkpoint: str) -> Iterator[tuple[str, str]]:
    """Yield each convention with its source, as Python literals."""
    images, action = block.get("images", []), block["action"]
    joints = [part["joints"] for part in [*block["state"][0]["parts"], *action["parts"]] if "joints" in part]
    grippers = [part["gripper"]["closed"] for part in action["parts"] if "gripper" in part]
    if images:
        yield "image_channels", repr(f"{CODE}/cameras/opencv/configuration_opencv.py:62")
        yield "image_range", repr(f"{CODE}/policies/utils.py:130")
        steps = next((view["steps"] for view in images if "steps" in view), None)
        itself = "assumed: the policy's own class resizes images"
        yield "image_size", _source(steps[0]["resize"]["to"], checkpoint) if steps else repr(itself)
        if steps:
            yield "image_filter", _source(steps[0]["resize"]["filter"], checkpoint)
        yield (
            "image_orientation",
            repr("assumed: LeRobot rotates no image, and the data has images as the cameras took them"),
        )
        yield "camera", _least_certain_source([view["cameras"] for view in images], checkpoint)
    if joints:
        yield "joint_order", _least_certain_source([how["arm"] for how in joints], checkpoint)
        yield "angle_unit", _least_certain_source([how["unit"] for how in joints], checkpoint)
    if grippers:
        yield "gripper", _least_certain_source(grippers, checkpoint)
    yield "action_reference", _source(action["reference"], checkpoint)
    yield "chunk", _source(trained.chunk, checkpoint)
    if trained.history is not None:
        yield "history_length", _source(trained.history["length"], checkpoint)
        yield "history_order", repr(f"{CODE}/policies/utils.py:46")
        yield "history_padding", repr(f"{CODE}/policies/utils.py:42")
        yield "history_stride", repr(f"{CODE}/policies/utils.py:46")
    if trained.instruction is not None:
        yield sdk.Obs.INSTRUCTION, repr(f"{CODE}/policies/utils.py:135")
    yield "normalization", repr(f"{CODE}/processor/normalize_processor.py:306")
    yield "sampling", _source(trained.sampling, checkpoint)


def _least_certain_source(trees: Sequence[Tree], checkpoint: str) -> str:
    """Return the source of several facts: that of the least certain one."""
    ranked = list(Confidence)
    facts = [leaf for leaf in trees if isinstance(leaf, Fact)]
    return _source(max(facts, key=lambda leaf: ranked.index(leaf.confidence)), checkpoint)


def _source(tree: Tree, checkpoint: str) -> str:
    """Return a source as a Python literal: file and line, or `assumed` where it is inferred."""
    if not isinstance(tree, Fact):
        raise UnknownFactError("a convention is unknown")
    first = tree.evidence[0]
    if tree.confidence is Confidence.CERTAIN and first.file:
        location = f"{first.file}:{first.line}" if first.line else first.file
        folder, _, name = location.partition("/")
        # Outside the package: by the name of the checkpoint or the dataset.
        return repr(f"{checkpoint}@checkpoint:{location}" if not name else f"{folder}@dataset:{name}")
    if first.file.startswith(CODE):
        return repr(f"{first.file} {first.what}")
    return repr(f"assumed: {first}"[:110])
