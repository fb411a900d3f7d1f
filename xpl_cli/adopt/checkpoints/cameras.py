"""Which of the standard's cameras a data set's camera is, by the names that data sets use.

A name is a word of somebody's: what is found here is `likely`, and a name that says nothing stays open.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.facts import Open, Told, certain, likely

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.adopt.facts import Evidence

_HEAD: Final = frozenset(
    ("head", "high", "top", "front", "main", "ego", "overhead", "base", "primary", "agentview", "agent", "exterior")
)
"""Words of cameras that see the whole scene: ALOHA cam_high and top, LIBERO and robomimic agentview, openpi base_0_rgb,
OpenVLA primary, GR00T ego_view, DROID exterior_image."""
_WRIST: Final = frozenset(("wrist", "hand", "gripper", "eye", "inhand"))
"""Words of cameras that a hand carries: ALOHA cam_left_wrist, robomimic robot0_eye_in_hand, openpi left_wrist_0_rgb."""
_THIRD: Final = frozenset(("third", "side", "low", "secondary"))
_SIDES: Final = {"left": "left", "l": "left", "right": "right", "r": "right"}
_NOISE: Final = re.compile("observation|images?|video|cam|camera|rgb|color|obs|view")


def standard_camera(name: str, arms: int, evidence: Evidence) -> Told | Open:
    """Return the standard's camera that a name means, as a list of one.

    Args:
        name: the data set's or the model's name of it.
        arms: arms of the robot, which decide what its cameras are called.
        evidence: where the name stands.
    """
    words = [word for word in re.split(r"[^a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()) if word]
    own = known(arms)
    head, *wrists, third = own
    exact = next((camera for camera in own if re.search(rf"(?:^|[^a-z]){camera}$", name)), None)
    if exact:
        return certain([exact], evidence)
    sides = [_SIDES[word] for word in words if word in _SIDES]
    said = {word for word in words if not _NOISE.fullmatch(word)}
    if said & _WRIST and len(set(sides)) < 2:
        # In the order of the arms: one wrist, or the left one and the right one.
        found = next((camera for camera in wrists if arms == 1 or (sides and sides[0] in camera)), None)
        if found:
            return likely([found], evidence)
    elif said & _THIRD:
        return likely([third], evidence)
    elif said & _HEAD or not said:
        return likely([head], evidence)
    return Open(f"which camera {name!r} is: its name does not say; one of {', '.join(own)}", (evidence,))


def known(arms: int) -> tuple[str, ...]:
    """Return the names of the standard's cameras of a robot."""
    from xpl_cli.standard import spec

    cameras = spec.data("conventions")["cameras"]
    return (*cameras["by_arms"][arms], *cameras["optional"])


def without_twins(cameras: Sequence[Told | Open], names: Iterable[str]) -> list[Told | Open]:
    """Return cameras of which none is taken twice: where two names mean one camera, the later one is open."""
    taken: set[str] = set()
    result: list[Told | Open] = []
    for camera, name in zip(cameras, names, strict=True):
        if isinstance(camera, Told) and camera.value[0] in taken:
            reason = f"which camera {name!r} is: {camera.value[0]} is another one's already"
            result.append(Open(reason, camera.evidence))
            continue
        if isinstance(camera, Told):
            taken.add(camera.value[0])
        result.append(camera)
    return result
