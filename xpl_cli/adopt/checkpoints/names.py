"""Names of numbers that makers give whole groups of: what `left_arm` with six numbers is, number by number."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from xpl_cli.basics.errors import UserError

_AXES: Final = ("x", "y", "z")
_TURNED: Final = {3: ["axis_angle1", "axis_angle2", "axis_angle3"], 4: ["qx", "qy", "qz", "qw"]}
"""Of robosuite, GR00T's simulations and LIBERO: three numbers are an axis with its angle, four end with w."""
_MOST: Final = 10_000
_ARM: Final = re.compile(r"arm|joint|qpos")
_GRIPPER: Final = re.compile(r"grip|finger|claw|jaw")
_HAND: Final = re.compile(r"hand")
_POSITION: Final = re.compile(r"pos|xyz|trans")
_ROTATION: Final = re.compile(r"rot|quat|ori")


def of_groups(groups: Iterable[tuple[str, int]]) -> list[str]:
    """Return a name for each number of some groups.

    Args:
        groups: name and count of each, in the order of the vector.

    Raises:
        UserError: there are more than any vector has.
    """
    listed = list(groups)
    if sum(max(count, 0) for _, count in listed) > _MOST:
        told = ", ".join(f"{group} has {count}" for group, count in listed[:9])
        raise UserError(f"expected a vector of at most {_MOST} numbers: {told[:200]}")
    return [name for group, count in listed for name in _of(group, count)]


def _of(group: str, count: int) -> list[str]:
    word = group.lower()
    if count == 1:
        return [group]
    if _GRIPPER.search(word) or _HAND.search(word):
        ends = [str(index) for index in range(count)]
    elif _ROTATION.search(word):
        ends = _TURNED.get(count) or [f"rot6d_{index}" for index in range(count)]
    elif _POSITION.search(word) and count == len(_AXES) and not re.search(r"joint|qpos", word):
        ends = [*_AXES]
    elif _ARM.search(word):
        ends = [f"joint_{index + 1}" for index in range(count)]
    else:
        ends = [str(index) for index in range(count)]
    return [f"{group}_{end}" for end in ends]
