"""A draft of a `model_io` block and of an embodiment from the probe's answers; unknown values are marked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.data.probe.grippers import LARGER
from xpl_cli.data.probe.parts import ARM, GRIPPER, JOINTS, POSITION, ROTATION, THREE
from xpl_cli.data.probe.sample import COMMAND, STATE

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl_cli.data.probe.parts import VectorPart
    from xpl_cli.data.probe.probe import ProbeResult

_HEAD = """\
# Drafted by `xpl data probe`; every value was measured, or says why it is unknown.
# `model_io` goes into policy.yml. Each row of an action is relative to the state of its own step: for a model that
# predicts action chunks, `delta_state` is `cumulative`, unless training took deltas to the first state of the chunk.
"""
_ROBOT = """\
# `embodiment` is the robot: a name that `xpl spec show` lists, or the content of embodiments/NAME.yml.
"""


def draft_yaml(result: ProbeResult) -> str:
    """Return the draft as YAML."""
    import yaml

    model_io, robot = model_io_block(result), embodiment(result)
    model_io_yaml = yaml.safe_dump(
        _without_aliases({"model_io": model_io}), sort_keys=False, allow_unicode=True, width=110
    )
    embodiment_yaml = yaml.safe_dump(
        _without_aliases({"embodiment": robot}), sort_keys=False, allow_unicode=True, width=110
    )
    return f"{_HEAD}{model_io_yaml}\n{_ROBOT}{embodiment_yaml}"


def _without_aliases(value: object) -> Any:
    """Return a deep copy without shared objects, so that YAML writes no anchors."""
    if isinstance(value, dict):
        return {key: _without_aliases(entry) for key, entry in value.items()}
    return [_without_aliases(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def model_io_block(result: ProbeResult) -> dict[str, Any]:
    """Return a `model_io` block (spec/v1/model_io.schema.json)."""
    block: dict[str, Any] = {}
    images = [_image(result, name) for name in _cameras(result)]
    if images:
        block["images"] = images
    columns = dict.fromkeys(part.series.name for part in result.state)
    block["state"] = [
        {"input": name.replace("/", ".").replace("-", "_"), "parts": _parts(result, result.state, name, STATE)}
        for name in columns
    ]
    parts = _command_parts(result)
    references = {
        answer.value if answer.is_known else None
        for answer in result.answers
        if answer.topic == "reference" and any(answer.subject == part for part in _subjects(result.command))
    }
    if len(references) == 1 and None not in references:
        block["action"] = {"reference": references.pop(), "parts": parts}
    else:
        block["action"] = {"reference": _unknown_reason(result, "reference", _subjects(result.command)), "parts": parts}
    return block


def embodiment(result: ProbeResult) -> dict[str, Any]:
    """Return the robot's name where it is known, else a draft of its embodiment file."""
    robots = {one.value for one in result.answers if one.topic == "robot" and one.is_known}
    if len(robots) == 1:
        return {"robot": robots.pop()}
    states = list(result.arms.values())
    joints = next((one.joints for one in states if one.joints is not None), None)
    first = None
    if joints is not None:
        unit = next((one.unit for one in states if one.joints is not None), None)
        first = [round(float(value), 4) for value in joints.rows[0][0] * (unit or 1.0)]
    names = joints.series.names[joints.start : joints.stop] if joints is not None and joints.series.names else ()
    grippers = [part for part in result.state if part.kind == GRIPPER]
    return {
        "name": "my_robot",
        "description": "Drafted from demonstrations: describe the robot.",
        "arms": ["left", "right"] if len(states) == 2 else ["single"],
        "arm": {
            "dof": joints.width if joints is not None else None,
            "home": first,
            "joints": [{"name": name, "limits": None, "velocity": None} for name in names] or None,
        },
        "end_effector": {"kind": "parallel_gripper", "dim": 1 if grippers else 0, "stroke": None, "tcp": None},
    }


def _cameras(result: ProbeResult) -> list[str]:
    return [one.subject for one in result.answers if one.topic == "camera"]


def _image(result: ProbeResult, name: str) -> dict[str, Any]:
    """Return the entry of a camera."""
    mount = result.value("camera", name)
    two = len(result.arms) == 2
    names_by_mount = {"fixed": sdk.CAMERAS[1][0], "wrist": None if two else sdk.CAMERAS[1][1]}
    names_by_mount |= {f"wrist of {side}": f"cam_{side}_wrist" for side in ("left", "right")}
    camera = names_by_mount.get(mount or "")
    entry: dict[str, Any] = {"input": name.replace("/", ".").replace("-", "_")}
    entry["cameras"] = [camera] if camera else _unknown_reason(result, "camera", [name])
    if result.value("orientation", name) == "upside down":
        entry["steps"] = [{"rotate": 180}]
    channels = result.value("channels", name)
    entry["channels"] = channels or _unknown_reason(result, "channels", [name])
    return {**entry, "layout": "hwc", "dtype": "uint8"}


def _subjects(parts: Iterable[VectorPart]) -> list[str]:
    """Return the subjects of parts, and of the halves of six-number parts."""
    subjects = []
    for part in parts:
        subjects.append(part.subject)
        if part.kind == ARM:
            subjects += [part.cut(POSITION, 0, 3).subject, part.cut(ROTATION, 3, 6).subject]
    return subjects


def _command_parts(result: ProbeResult) -> Any:
    """Return the parts of all command columns, concatenated."""
    joined: list[Any] = []
    for name in dict.fromkeys(part.series.name for part in result.command):
        parts = _parts(result, result.command, name, COMMAND)
        if isinstance(parts, dict):
            return parts
        joined += parts
    return joined or _unknown("the dataset has no commands")


def _parts(result: ProbeResult, parts: list[VectorPart], column: str | None, role: str) -> Any:
    """Return the parts of a column; unknown as a whole where one of them is unknown."""
    entries: list[dict[str, Any]] = []
    for part in parts:
        if part.series.name != column:
            continue
        halves = [part]
        if part.kind == ARM and result.value("kind", part.cut(POSITION, 0, 3).subject) == POSITION:
            halves = [part.cut(POSITION, 0, 3), part.cut(ROTATION, 3, 6)]
        for half in halves:
            entry = _part(result, half, role)
            if entry is None:
                why = result.of("kind", half.subject)
                return _unknown(f"{half.subject}: {why.evidence if why is not None else 'of unknown kind'}")
            entries.append(entry)
    return entries


def _part(result: ProbeResult, part: VectorPart, role: str) -> dict[str, Any] | None:
    """Return the entry of a part; None if its kind is unknown."""
    arm = {"arm": _side(result, part)}
    kind = GRIPPER if part.kind == GRIPPER else result.value("kind", part.subject)
    if kind == GRIPPER:
        return {GRIPPER: {**arm, **_gripper_ends(result, part)}}
    if kind == JOINTS:
        unit = result.value("angle unit", part.subject)
        entry = {**arm, "unit": unit or _unknown_reason(result, "angle unit", [part.subject])}
        order = result.value("joint order", part.subject)
        arm_state = result.arms.get(part.arm)
        if order is None and role == COMMAND and arm_state is not None and arm_state.joints is not None:
            order = result.value("joint order", arm_state.joints.subject)
        return {JOINTS: {**entry, **({"names": order} if order else {})}}
    if kind == POSITION or part.kind == THREE:
        return {POSITION: {**arm, **_pose(result, part)}}
    if kind == ROTATION:
        form = result.value("rotation form", part.subject)
        form_words = form.split() if form else []
        form_entry: dict[str, Any] = {
            "form": form_words[0] if form_words else _unknown_reason(result, "rotation form", [part.subject])
        }
        if len(form_words) > 1:
            form_entry["euler"] = form_words[1]
        return {ROTATION: {**arm, **form_entry, **_pose(result, part, length=False)}}
    return None


def _pose(result: ProbeResult, part: VectorPart, *, length: bool = True) -> dict[str, Any]:
    """Return frame, point, unit and where a delta is applied; commands take those of the state."""
    arm_state = result.arms.get(part.arm)
    subject = arm_state.position.subject if arm_state is not None and arm_state.position is not None else part.subject
    entry: dict[str, Any] = {
        name: result.value(name, subject) or _unknown_reason(result, name, [subject]) for name in ("point", "frame")
    }
    if length:
        entry["unit"] = result.value("length unit", subject) or _unknown_reason(result, "length unit", [subject])
    applied = result.value("applied", part.subject)
    return {**entry, **({"applied": applied} if applied else {})}


def _gripper_ends(result: ProbeResult, part: VectorPart) -> dict[str, Any]:
    """Return the values of the closed and the open gripper."""
    span, direction = result.value("gripper range", part.subject), result.value("gripper direction", part.subject)
    if direction is None or span is None:
        open_ = _unknown_reason(result, "gripper direction", [part.subject])
        return {"closed": open_, "open": open_}
    closed, opened = span if direction == LARGER else span[::-1]
    closed, opened = round(closed, 4), round(opened, 4)
    if part in result.state:
        return {
            "closed": _unknown(f"{closed} is the most closed value in the data; an object may be in between"),
            "open": opened,
        }
    return {"closed": closed, "open": opened}


def _side(result: ProbeResult, part: VectorPart) -> str:
    """Return the standard's name of an arm; of two indistinguishable ones the first is the left."""
    if len(result.arms) < 2:
        return "single"
    arm_state = result.arms.get(part.arm)
    if arm_state is not None and arm_state.reading is not None and arm_state.reading.frame == "world":
        return arm_state.reading.side
    return part.side or ("left", "right")[part.arm % 2]


def _unknown_reason(result: ProbeResult, topic: str, subjects: Iterable[str]) -> dict[str, str]:
    """Return an unknown value with the probe's reason."""
    for subject in subjects:
        answer = result.of(topic, subject)
        if answer is not None:
            return _unknown(answer.evidence if not answer.is_known else f"the parts differ: {answer.value} and others")
    return _unknown("the probe does not measure it")


def _unknown(why: str) -> dict[str, str]:
    return {"unknown": why}
