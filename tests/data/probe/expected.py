"""What is true of a set that was written under a convention, and how what a probe says compares with it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import get_embodiment

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tests.support.recordings.demonstrations import Convention
    from tests.support.recordings.motion import Motion
    from xpl_cli.data.probe.probe import ProbeResult

WIDTHS = {"position": 3, "gripper": 1, "fingers": 2}
FORMS = {"quaternion_wxyz": 4, "quaternion_xyzw": 4, "matrix": 9, "rot6d_columns": 6, "rot6d_rows": 6}


def expected(motions: Sequence[Motion], how: Convention) -> dict[tuple[str, str], Any]:
    """Return what is true, by topic and subject."""
    robot = get_embodiment(motions[0].robot)
    dof = robot.arms[0].dof
    names = list(robot.arms[0].joint_names or ())
    sides = list(motions[0].joints)
    truth: dict[tuple[str, str], Any] = {}
    totals = {"observation.state": 0, "action": 0}
    width = {**WIDTHS, "joints": dof, "rotation": FORMS.get(how.form, 3)}
    for column, parts in (("observation.state", how.state), ("action", how.action)):
        totals[column] = len(sides) * sum(width[part] for part in parts)
    at = dict.fromkeys(totals, 0)
    if how.stamps:
        truth["rate", "set"] = 25.0 / how.every
    for side in sides:
        prefix = "" if side == "single" else f"{side}_"
        where: dict[tuple[str, str], str] = {}
        for column, parts, role in (("observation.state", how.state, "s"), ("action", how.action, "a")):
            for part in parts:
                begin = at[column]
                whole = width[part] == totals[column]
                where[role, part] = column if whole else f"{column}[{begin}:{begin + width[part]}]"
                if how.separate and role == "s":
                    where[role, part] = f"obs/{prefix}{part}"
                else:
                    at[column] += width[part]
        if how.beside:
            where["s", "joints"] = f"observation.{prefix}joints"
        _of_side(truth, where, how, robot=motions[0].robot, side=side, names=names)
    if how.normalise:
        truth["normalize", "action"] = how.normalise
    return truth


def _of_side(
    truth: dict[Any, Any], where: dict[Any, str], how: Convention, *, robot: str, side: str, names: list[str]
) -> None:
    for (role, part), subject in where.items():
        kind = {"fingers": "gripper"}.get(part, part)
        if kind == "gripper":
            ends = how.gripper if role == "s" else how.action_gripper
            truth["gripper direction", subject] = "larger is open" if ends[1] > ends[0] else "smaller is open"
            continue
        truth["kind", subject] = kind
        if part == "joints" and not (role == "a" and how.normalise):
            truth["angle unit", subject] = "deg" if how.unit < 1 else "rad"
        if part == "rotation":
            name = how.form + (f" {how.euler}" if how.euler else "") + (" in degrees" if how.degrees else "")
            truth["rotation form", subject] = name
        if role == "a":
            truth["reference", subject] = how.reference
            if part in {"position", "rotation"} and how.reference != "absolute":
                truth["applied", subject] = how.applied
    if ("a", "joints") in where:
        own, other = how.order or range(len(names)), how.action_order or how.order or range(len(names))
        found = [list(other).index(joint) for joint in own]
        truth["order", where["a", "joints"]] = "as the state" if found == sorted(found) else found
    if ("s", "position") in where:
        _of_pose(truth, where, how, robot=robot, side=side, names=names)


def _of_pose(
    truth: dict[Any, Any], where: dict[Any, str], how: Convention, *, robot: str, side: str, names: list[str]
) -> None:
    subject = where["s", "position"]
    truth["length unit", subject] = {1.0: "m", 0.01: "cm", 0.001: "mm"}[how.length]
    truth["frame", subject], truth["point", subject] = how.frame, how.point
    if side != "single" and how.frame == "world":
        truth["side", subject] = side
    if ("s", "joints") in where:
        truth["robot", where["s", "joints"]] = robot
        truth["joint order", where["s", "joints"]] = [names[joint] for joint in how.order or range(len(names))]


FREE = {"gripper range", "idle start", "latency", "camera", "orientation", "channels", "rate"}
"""Topics that are checked by tests of their own, or that a convention does not fix."""


def judge(answers: ProbeResult, motions: Sequence[Motion], how: Convention) -> tuple[list[str], list[str], list[str]]:
    """Return what a probe says right, what it says wrong, and what is true and it does not know."""
    truth = expected(motions, how)
    right, wrong, missing = [], [], []
    for answer in answers.answers:
        if not answer.is_known or (answer.topic in FREE and (answer.topic, answer.subject) not in truth):
            continue
        key = (answer.topic, answer.subject)
        claims = f"{answer.topic} of {answer.subject}: {answer.value}"
        if key not in truth:
            wrong.append(f"{claims}, of which nothing is so")
        elif truth[key] == answer.value or (
            isinstance(truth[key], float) and np.isclose(truth[key], answer.value, rtol=0.01)
        ):
            right.append(claims)
        else:
            wrong.append(f"{claims}, and it is {truth[key]}")
    known = {(answer.topic, answer.subject) for answer in answers.answers if answer.is_known}
    missing = [
        f"{topic} of {subject}: {value}" for (topic, subject), value in truth.items() if (topic, subject) not in known
    ]
    return right, wrong, missing
