"""The initial model_io block of a scaffold: a model with the standard's own conventions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import robots
from xpl_cli.scaffold import kinds

if TYPE_CHECKING:
    from xpl_cli.scaffold.answers import AdapterAnswers

_GRIPPER = "parallel_gripper"


def images(answers: AdapterAnswers) -> list[dict[str, Any]]:
    """Return one uint8 image input per camera, under the camera's name."""
    names = [kinds.camera(text).name for text in answers.cameras]
    return [{"input": name, "cameras": [name], "channels": "rgb", "layout": "hwc", "dtype": "uint8"} for name in names]


def parts(answers: AdapterAnswers) -> list[dict[str, Any]]:
    """Return the parts of the standard's action vector, in the order of `xpl.action.pack`."""
    robot = robots.entries()[answers.embodiment]
    result: list[dict[str, Any]] = []
    for arm in robot["arms"]:
        if answers.action_type == sdk.ACTION_TYPES[0]:
            result.append({"joints": {"arm": arm}})
        else:
            result += [{"position": {"arm": arm}}, {"rotation": {"arm": arm, "form": "quaternion_wxyz"}}]
        is_gripper = robot["end_effector"]["kind"] == _GRIPPER
        result.append({"gripper": {"arm": arm, "closed": 0, "open": 1}} if is_gripper else {"hand": {"arm": arm}})
    return result
