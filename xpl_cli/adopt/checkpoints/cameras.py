"""The standard's camera for a dataset's camera name.

Names are not standardised: a match is `likely`, and a name without a hint stays unknown.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.facts import Fact, UnknownFact, certain, likely

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.adopt.facts import Evidence

_HEAD: Final = frozenset(
    ("head", "high", "top", "front", "main", "ego", "overhead", "base", "primary", "agentview", "agent", "exterior")
)
"""Words in names of cameras that see the whole scene: ALOHA cam_high and top, LIBERO and robomimic agentview, openpi
base_0_rgb, OpenVLA primary, GR00T ego_view, DROID exterior_image."""
_WRIST: Final = frozenset(("wrist", "hand", "gripper", "eye", "inhand"))
"""Words in names of wrist cameras: ALOHA cam_left_wrist, robomimic robot0_eye_in_hand, openpi left_wrist_0_rgb."""
_THIRD: Final = frozenset(("third", "side", "low", "secondary"))
_SIDES: Final = {"left": "left", "l": "left", "right": "right", "r": "right"}
_NOISE: Final = re.compile("observation|images?|video|cam|camera|rgb|color|obs|view")


def standard_camera(name: str, arms: int, evidence: Evidence) -> Fact | UnknownFact:
    """Return the standard's camera for a name, as a list of one.

    Args:
        name: the dataset's or the model's name.
        arms: number of arms, which sets the standard's camera names.
        evidence: where the name stands.
    """
    words = [word for word in re.split(r"[^a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()) if word]
    own = standard_cameras(arms)
    head, *wrists, third = own
    exact = next((camera for camera in own if re.search(rf"(?:^|[^a-z]){camera}$", name)), None)
    if exact:
        return certain([exact], evidence)
    sides = [_SIDES[word] for word in words if word in _SIDES]
    hints = {word for word in words if not _NOISE.fullmatch(word)}
    if hints & _WRIST and len(set(sides)) < 2:
        # In the order of the arms: one wrist, or the left one and the right one.
        wrist = next((camera for camera in wrists if arms == 1 or (sides and sides[0] in camera)), None)
        if wrist:
            return likely([wrist], evidence)
    elif hints & _THIRD:
        return likely([third], evidence)
    elif hints & _HEAD or not hints:
        return likely([head], evidence)
    return UnknownFact(f"which camera {name!r} is: its name gives no hint; one of {', '.join(own)}", (evidence,))


def standard_cameras(arms: int) -> tuple[str, ...]:
    """Return the standard's camera names for a robot with so many arms."""
    from xpl_cli.standard import spec

    cameras = spec.data("conventions")["cameras"]
    return (*cameras["by_arms"][arms], *cameras["optional"])


def without_duplicates(cameras: Sequence[Fact | UnknownFact], names: Iterable[str]) -> list[Fact | UnknownFact]:
    """Return the cameras without duplicates: where two names match one camera, the later one is unknown."""
    used: set[str] = set()
    result: list[Fact | UnknownFact] = []
    for camera, name in zip(cameras, names, strict=True):
        if isinstance(camera, Fact) and camera.value[0] in used:
            reason = f"which camera {name!r} is: {camera.value[0]} is taken by another one"
            result.append(UnknownFact(reason, camera.evidence))
            continue
        if isinstance(camera, Fact):
            used.add(camera.value[0])
        result.append(camera)
    return result
