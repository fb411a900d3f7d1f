"""A draft of a `model_io` block and of an embodiment, with what was measured; what is unknown says so in its place."""

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
# Drafted by `xpl data probe`; every value was measured, or says why it is not known.
# `model_io` goes into policy.yml. Each row of an action counts from the state of its own time: for a model that answers
# several steps at once, `delta_state` is `cumulative`, unless training counted all of a chunk from its first state.
"""
_ROBOT = """\
# `embodiment` is the robot: a name that `xpl spec show` knows, or what embodiments/NAME.yml has to say.
"""


def draft_yaml(found: ProbeResult) -> str:
    """Return the draft as YAML."""
    import yaml

    model_io, robot = model_io_block(found), embodiment(found)
    said = yaml.safe_dump(_without_aliases({"model_io": model_io}), sort_keys=False, allow_unicode=True, width=110)
    other = yaml.safe_dump(_without_aliases({"embodiment": robot}), sort_keys=False, allow_unicode=True, width=110)
    return f"{_HEAD}{said}\n{_ROBOT}{other}"


def _without_aliases(value: object) -> Any:
    """Return a copy in which nothing is there twice, so that YAML needs no anchors."""
    if isinstance(value, dict):
        return {key: _without_aliases(entry) for key, entry in value.items()}
    return [_without_aliases(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def model_io_block(found: ProbeResult) -> dict[str, Any]:
    """Return a `model_io` block (spec/v1/model_io.schema.json)."""
    made: dict[str, Any] = {}
    images = [_image(found, name) for name in _cameras(found)]
    if images:
        made["images"] = images
    columns = dict.fromkeys(part.series.name for part in found.state)
    made["state"] = [
        {"input": name.replace("/", ".").replace("-", "_"), "parts": _parts(found, found.state, name, STATE)}
        for name in columns
    ]
    parts = _command_parts(found)
    references = {
        answer.value if answer.is_known else None
        for answer in found.answers
        if answer.topic == "reference" and any(answer.subject == part for part in _subjects(found.command))
    }
    if len(references) == 1 and None not in references:
        made["action"] = {"reference": references.pop(), "parts": parts}
    else:
        made["action"] = {"reference": _unknown_reason(found, "reference", _subjects(found.command)), "parts": parts}
    return made


def embodiment(found: ProbeResult) -> dict[str, Any]:
    """Return the robot's name where it is known, else what is known for a file of its own."""
    robots = {one.value for one in found.answers if one.topic == "robot" and one.is_known}
    if len(robots) == 1:
        return {"robot": robots.pop()}
    states = list(found.arms.values())
    joints = next((one.joints for one in states if one.joints is not None), None)
    first = None
    if joints is not None:
        unit = next((one.unit for one in states if one.joints is not None), None)
        first = [round(float(value), 4) for value in joints.rows[0][0] * (unit or 1.0)]
    names = joints.series.names[joints.start : joints.stop] if joints is not None and joints.series.names else ()
    grippers = [part for part in found.state if part.kind == GRIPPER]
    return {
        "name": "my_robot",
        "description": "Drafted of demonstrations: say what it is.",
        "arms": ["left", "right"] if len(states) == 2 else ["single"],
        "arm": {
            "dof": joints.width if joints is not None else None,
            "home": first,
            "joints": [{"name": name, "limits": None, "velocity": None} for name in names] or None,
        },
        "end_effector": {"kind": "parallel_gripper", "dim": 1 if grippers else 0, "stroke": None, "tcp": None},
    }


def _cameras(found: ProbeResult) -> list[str]:
    return [one.subject for one in found.answers if one.topic == "camera"]


def _image(found: ProbeResult, name: str) -> dict[str, Any]:
    """Return the entry of a camera."""
    place = found.value("camera", name)
    two = len(found.arms) == 2
    known = {"fixed": sdk.CAMERAS[1][0], "wrist": None if two else sdk.CAMERAS[1][1]}
    known |= {f"wrist of {side}": f"cam_{side}_wrist" for side in ("left", "right")}
    camera = known.get(place or "")
    entry: dict[str, Any] = {"input": name.replace("/", ".").replace("-", "_")}
    entry["cameras"] = [camera] if camera else _unknown_reason(found, "camera", [name])
    if found.value("orientation", name) == "upside down":
        entry["steps"] = [{"rotate": 180}]
    channels = found.value("channels", name)
    entry["channels"] = channels or _unknown_reason(found, "channels", [name])
    return {**entry, "layout": "hwc", "dtype": "uint8"}


def _subjects(parts: Iterable[VectorPart]) -> list[str]:
    """Return how parts of six numbers and their halves are told."""
    found = []
    for part in parts:
        found.append(part.subject)
        if part.kind == ARM:
            found += [part.cut(POSITION, 0, 3).subject, part.cut(ROTATION, 3, 6).subject]
    return found


def _command_parts(found: ProbeResult) -> Any:
    """Return the parts of all columns of commands, one after the other."""
    joined: list[Any] = []
    for name in dict.fromkeys(part.series.name for part in found.command):
        parts = _parts(found, found.command, name, COMMAND)
        if isinstance(parts, dict):
            return parts
        joined += parts
    return joined or _unknown("the set has no commands")


def _parts(found: ProbeResult, parts: list[VectorPart], column: str | None, role: str) -> Any:
    """Return the parts of a column; that they are open where one of them is."""
    entries: list[dict[str, Any]] = []
    for part in parts:
        if part.series.name != column:
            continue
        halves = [part]
        if part.kind == ARM and found.value("kind", part.cut(POSITION, 0, 3).subject) == POSITION:
            halves = [part.cut(POSITION, 0, 3), part.cut(ROTATION, 3, 6)]
        for half in halves:
            entry = _part(found, half, role)
            if entry is None:
                why = found.of("kind", half.subject)
                return _unknown(f"{half.subject}: {why.evidence if why is not None else 'nobody knows what it is'}")
            entries.append(entry)
    return entries


def _part(found: ProbeResult, part: VectorPart, role: str) -> dict[str, Any] | None:
    """Return the entry of a part, None if nobody knows what it is."""
    arm = {"arm": _side(found, part)}
    kind = GRIPPER if part.kind == GRIPPER else found.value("kind", part.subject)
    if kind == GRIPPER:
        return {GRIPPER: {**arm, **_gripper_ends(found, part)}}
    if kind == JOINTS:
        unit = found.value("angle unit", part.subject)
        entry = {**arm, "unit": unit or _unknown_reason(found, "angle unit", [part.subject])}
        order = found.value("joint order", part.subject)
        seen = found.arms.get(part.arm)
        if order is None and role == COMMAND and seen is not None and seen.joints is not None:
            order = found.value("joint order", seen.joints.subject)
        return {JOINTS: {**entry, **({"names": order} if order else {})}}
    if kind == POSITION or part.kind == THREE:
        return {POSITION: {**arm, **_pose(found, part)}}
    if kind == ROTATION:
        form = found.value("rotation form", part.subject)
        words = form.split() if form else []
        said: dict[str, Any] = {"form": words[0] if words else _unknown_reason(found, "rotation form", [part.subject])}
        if len(words) > 1:
            said["euler"] = words[1]
        return {ROTATION: {**arm, **said, **_pose(found, part, length=False)}}
    return None


def _pose(found: ProbeResult, part: VectorPart, *, length: bool = True) -> dict[str, Any]:
    """Return frame, point, unit and where a change is applied; those of the state hold for commands, too."""
    seen = found.arms.get(part.arm)
    place = seen.position.subject if seen is not None and seen.position is not None else part.subject
    entry: dict[str, Any] = {
        name: found.value(name, place) or _unknown_reason(found, name, [place]) for name in ("point", "frame")
    }
    if length:
        entry["unit"] = found.value("length unit", place) or _unknown_reason(found, "length unit", [place])
    applied = found.value("applied", part.subject)
    return {**entry, **({"applied": applied} if applied else {})}


def _gripper_ends(found: ProbeResult, part: VectorPart) -> dict[str, Any]:
    """Return the values of a closed and an open gripper."""
    span, direction = found.value("gripper range", part.subject), found.value("gripper direction", part.subject)
    if direction is None or span is None:
        open_ = _unknown_reason(found, "gripper direction", [part.subject])
        return {"closed": open_, "open": open_}
    closed, opened = span if direction == LARGER else span[::-1]
    closed, opened = round(closed, 4), round(opened, 4)
    if part in found.state:
        return {
            "closed": _unknown(f"{closed} is the most closed that was seen; something may be between"),
            "open": opened,
        }
    return {"closed": closed, "open": opened}


def _side(found: ProbeResult, part: VectorPart) -> str:
    """Return an arm in the standard's words; of two that nothing tells apart the first is the left one."""
    if len(found.arms) < 2:
        return "single"
    seen = found.arms.get(part.arm)
    if seen is not None and seen.reading is not None and seen.reading.frame == "world":
        return seen.reading.side
    return part.side or ("left", "right")[part.arm % 2]


def _unknown_reason(found: ProbeResult, topic: str, subjects: Iterable[str]) -> dict[str, str]:
    """Return that a value is open, with the probe's reason."""
    for subject in subjects:
        answer = found.of(topic, subject)
        if answer is not None:
            return _unknown(answer.evidence if not answer.is_known else f"the parts differ: {answer.value} and others")
    return _unknown("nothing measures it")


def _unknown(why: str) -> dict[str, str]:
    return {"unknown": why}
