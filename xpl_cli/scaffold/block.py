"""The block model_io that a scaffold begins with: a model that speaks the standard's own words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import robots
from xpl_cli.scaffold import kinds

if TYPE_CHECKING:
    from xpl_cli.scaffold.answers import Answers

_GRIPPER = "parallel_gripper"


def images(answers: Answers) -> list[dict[str, Any]]:
    """Return an image input for each camera, under its name: bytes as they come."""
    names = [kinds.camera(text).name for text in answers.cameras]
    return [{"input": name, "cameras": [name], "channels": "rgb", "layout": "hwc", "dtype": "uint8"} for name in names]


def parts(answers: Answers) -> list[dict[str, Any]]:
    """Return the parts of the standard's vector of an action, in the order of `xpl.action.pack`."""
    robot = robots.entries()[answers.embodiment]
    found: list[dict[str, Any]] = []
    for arm in robot["arms"]:
        if answers.action_type == sdk.ACTION_TYPES[0]:
            found.append({"joints": {"arm": arm}})
        else:
            found += [{"position": {"arm": arm}}, {"rotation": {"arm": arm, "form": "quaternion_wxyz"}}]
        is_gripper = robot["end_effector"]["kind"] == _GRIPPER
        found.append({"gripper": {"arm": arm, "closed": 0, "open": 1}} if is_gripper else {"hand": {"arm": arm}})
    return found
