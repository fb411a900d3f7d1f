"""Names of single numbers for frameworks that name groups only, such as `left_arm` with six numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from xpl_cli.basics.errors import UserError

_AXES: Final = ("x", "y", "z")
_TURNED: Final = {3: ["axis_angle1", "axis_angle2", "axis_angle3"], 4: ["qx", "qy", "qz", "qw"]}
"""Rotations of robosuite, GR00T's simulations and LIBERO: three numbers are axis-angle, four are x, y, z, w."""
_MOST: Final = 10_000
_ARM: Final = re.compile(r"arm|joint|qpos")
_GRIPPER: Final = re.compile(r"grip|finger|claw|jaw")
_HAND: Final = re.compile(r"hand")
_POSITION: Final = re.compile(r"pos|xyz|trans")
_ROTATION: Final = re.compile(r"rot|quat|ori")


def names_of_groups(groups: Iterable[tuple[str, int]]) -> list[str]:
    """Return a name for each number of some groups.

    Args:
        groups: name and count of each, in the order of the vector.

    Raises:
        UserError: there are more than 10,000 numbers.
    """
    pairs = list(groups)
    if sum(max(count, 0) for _, count in pairs) > _MOST:
        widths = ", ".join(f"{group} has {count}" for group, count in pairs[:9])
        raise UserError(f"expected a vector of at most {_MOST} numbers: {widths[:200]}")
    return [name for group, count in pairs for name in _names_of_group(group, count)]


def _names_of_group(group: str, count: int) -> list[str]:
    lower = group.lower()
    if count == 1:
        return [group]
    if _GRIPPER.search(lower) or _HAND.search(lower):
        ends = [str(index) for index in range(count)]
    elif _ROTATION.search(lower):
        ends = _TURNED.get(count) or [f"rot6d_{index}" for index in range(count)]
    elif _POSITION.search(lower) and count == len(_AXES) and not re.search(r"joint|qpos", lower):
        ends = [*_AXES]
    elif _ARM.search(lower):
        ends = [f"joint_{index + 1}" for index in range(count)]
    else:
        ends = [str(index) for index in range(count)]
    return [f"{group}_{end}" for end in ends]
