"""Do a policy and an environment fit? What both announce in hello is compared before the first step.

A policy announces `{name, embodiments, embodiment, action_types, action_type, control_frequency, inputs, cameras}`
(inputs: those it needs; cameras: the images it needs, as in policy.yml), an environment `{embodiment, action_type,
control_frequency, inputs, cameras}` (inputs: those it offers; cameras: width and height of its images). What one side
does not say, or says is null, is not compared.
"""

from __future__ import annotations

import numbers
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Callable

from xpl import _spec as spec
from xpl import robots

if TYPE_CHECKING:
    from xpl.contract import Announcement, Config
    from xpl.manifest import Manifest

_EMBODIMENT, _EMBODIMENTS, _ACTION_TYPES, _INPUTS = "embodiment", "embodiments", "action_types", "inputs"
_ACTION_TYPE, _FREQUENCY, _CAMERAS = spec.Deploy.ACTION_TYPE, "control_frequency", "cameras"
REAL_TIME = "real_time"
"""Whether an environment goes on while the policy thinks, as a robot does; its servers ask for a token."""
_SIDES, _EXACT = ("width", "height"), "exact"


class AnnouncementError(ValueError):
    """What one side announced is not what it should be.

    Attributes:
        field: where.
    """

    def __init__(self, message: str, field: str | None = None) -> None:
        super().__init__(message)
        self.field = field


def needs(manifest: Manifest, config: Config) -> Announcement:
    """Return what a policy announces.

    Args:
        manifest: its policy.yml.
        config: the configuration it runs with.
    """
    return {
        "name": config.get(spec.Deploy.POLICY_NAME),
        _EMBODIMENTS: _all_canonical(list(manifest.embodiments) or None),
        _EMBODIMENT: _canonical(config.get(spec.Deploy.ENV_CFG_TYPE)),
        _ACTION_TYPES: list(manifest.action_types) or None,
        _ACTION_TYPE: config.get(spec.Deploy.ACTION_TYPE),
        _FREQUENCY: manifest.control_frequency,
        _INPUTS: None if manifest.inputs is None else list(manifest.inputs.required),
        _CAMERAS: manifest.data.get(_CAMERAS),
    }


def checked(announced: object) -> dict[str, Any]:
    """Return what a side announced of what is compared, in plain Python; who announced it may have sent anything.

    Raises:
        AnnouncementError: if it is no map, or an entry is of another kind than it should be.
    """
    if announced is None:
        return {}
    if not isinstance(announced, Mapping):
        raise AnnouncementError(f"it must be a map, got {type(announced).__name__}")
    found: dict[str, Any] = {}
    for name, (kind, read) in _ENTRIES.items():
        given = announced.get(name)
        if given is not None:
            try:
                found[name] = read(given)
            except TypeError:
                raise AnnouncementError(f"{name} must be {kind}, got {type(given).__name__}", name) from None
    return found


def differences(policy: Announcement, environment: Announcement) -> list[dict[str, Any]]:
    """Return where policy and environment do not fit: maps with `field`, `policy`, `environment` and a `message`."""
    checks = (_choices, _rates, _missing, _images)
    return [
        {"field": field, "policy": wanted, "environment": offered, "message": message}
        for check in checks
        for field, wanted, offered, message in check(policy, environment)
    ]


_Difference = tuple[str, Any, Any, str]
"""Field, what the policy says of it, what the environment says, and both in a sentence."""


def _choices(policy: Announcement, environment: Announcement) -> Iterator[_Difference]:
    """Compare the robot and the kind of action with what the policy was started for, or declares."""
    for one, many in ((_EMBODIMENT, _EMBODIMENTS), (_ACTION_TYPE, _ACTION_TYPES)):
        offered, configured, declared = environment.get(one), policy.get(one), policy.get(many)
        if one == _EMBODIMENT:
            offered, configured = _canonical(offered) or offered, _canonical(configured) or configured
            declared = _all_canonical(declared)
        if offered is None:
            continue
        if configured is not None and configured != offered:
            yield (
                one,
                configured,
                offered,
                f"the policy was started for {one} {configured}, the environment has {offered}",
            )
        elif isinstance(declared, list) and offered not in declared:
            yield one, declared, offered, f"the policy takes {one} {' or '.join(map(str, declared))}, not {offered}"


def _rates(policy: Announcement, environment: Announcement) -> Iterator[_Difference]:
    wanted, offered = policy.get(_FREQUENCY), environment.get(_FREQUENCY)
    if None not in (wanted, offered) and wanted != offered:
        text = f"the policy's actions are meant for {wanted} Hz, the environment executes them at {offered} Hz"
        yield _FREQUENCY, wanted, offered, text


def _missing(policy: Announcement, environment: Announcement) -> Iterator[_Difference]:
    wanted, offered = policy.get(_INPUTS), environment.get(_INPUTS)
    if isinstance(wanted, list) and isinstance(offered, list):
        missing = [name for name in wanted if name not in offered]
        if missing:
            yield _INPUTS, wanted, offered, f"the environment does not offer {', '.join(map(str, missing))}"


def _images(policy: Announcement, environment: Announcement) -> Iterator[_Difference]:
    """Compare the images that the environment shows with those that the policy needs."""
    needed, shown = policy.get(_CAMERAS), environment.get(_CAMERAS)
    if not isinstance(needed, Mapping) or not isinstance(shown, Mapping):
        return
    for camera, need in needed.items():
        image = shown.get(camera)
        if isinstance(need, Mapping) and isinstance(image, Mapping) and not _will_do(need, image):
            size = " x ".join(str(need.get(side) or "any") for side in _SIDES)
            least = "" if need.get(_EXACT) else " or larger"
            got = " x ".join(str(image.get(side)) for side in _SIDES)
            yield _CAMERAS, needed, shown, f"the policy needs {camera} {size}{least}, the environment shows {got}"


def _will_do(need: Mapping[str, Any], image: Mapping[str, Any]) -> bool:
    """Tell whether an image has a size that a policy can work with."""
    sizes = [(need.get(side), image.get(side)) for side in _SIDES]
    said = [(wanted, offered) for wanted, offered in sizes if isinstance(wanted, int) and isinstance(offered, int)]
    return all(offered == wanted if need.get(_EXACT) else offered >= wanted for wanted, offered in said)


def sentence(found: list[dict[str, Any]]) -> str:
    """Return one sentence about the differences."""
    return "policy and environment do not fit: " + "; ".join(str(one["message"]) for one in found)


def _text(given: object) -> str:
    if not isinstance(given, str):
        raise TypeError
    return str(given)


def _number(given: object) -> float | int:
    if isinstance(given, bool) or not isinstance(given, numbers.Real):
        raise TypeError
    return int(given) if isinstance(given, numbers.Integral) else float(given)


def _flag(given: object) -> bool:
    if type(given) is not bool:
        raise TypeError
    return given


def _texts(given: object) -> list[str]:
    if not isinstance(given, (list, tuple)):
        raise TypeError
    return [_text(item) for item in given]


def _sizes(given: object) -> dict[str, dict[str, Any]]:
    if not isinstance(given, Mapping):
        raise TypeError
    return {_text(camera): _size(image) for camera, image in given.items()}


def _size(given: object) -> dict[str, Any]:
    if not isinstance(given, Mapping):
        raise TypeError
    sides = {side: _number(given[side]) for side in _SIDES if given.get(side) is not None}
    return {**sides, **({_EXACT: True} if given.get(_EXACT) is True else {})}


_ENTRIES: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "name": ("text", _text),
    _EMBODIMENT: ("text", _text),
    _EMBODIMENTS: ("a list of text", _texts),
    _ACTION_TYPE: ("text", _text),
    _ACTION_TYPES: ("a list of text", _texts),
    _FREQUENCY: ("a number", _number),
    _INPUTS: ("a list of text", _texts),
    REAL_TIME: ("true or false", _flag),
    _CAMERAS: ("a map of maps with width and height", _sizes),
}


def _all_canonical(names: object) -> Any:
    return [_canonical(name) or name for name in names] if isinstance(names, list) else names


def _canonical(name: object) -> str | None:
    return robots.canonical(name)
