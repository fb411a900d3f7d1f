"""Compatibility of policy and environment: what both announce in hello is compared before the first step.

A policy announces `{name, embodiments, embodiment, action_types, action_type, control_frequency, inputs, cameras}`
(inputs: those it needs; cameras: the images it needs, as in policy.yml), an environment `{embodiment, action_type,
control_frequency, inputs, cameras}` (inputs: those it offers; cameras: width and height of its images). An entry that
one side leaves out, or gives as null, is not compared.
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
"""Whether the environment keeps moving during inference, as a robot does; its servers require a token."""
_SIDES, _EXACT = ("width", "height"), "exact"


class AnnouncementError(ValueError):
    """An announcement is malformed.

    Attributes:
        field: the entry, None where the announcement is no map.
    """

    def __init__(self, message: str, field: str | None = None) -> None:
        super().__init__(message)
        self.field = field


def policy_announcement(manifest: Manifest, config: Config) -> Announcement:
    """Return the announcement of a policy.

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


def validate_announcement(announced: object) -> dict[str, Any]:
    """Return the entries that are compared, as plain Python values.

    Args:
        announced: what a client or a server sent: untrusted input.

    Raises:
        AnnouncementError: it is no map, or an entry has the wrong type.
    """
    if announced is None:
        return {}
    if not isinstance(announced, Mapping):
        raise AnnouncementError(f"it must be a map, got {type(announced).__name__}")
    entries: dict[str, Any] = {}
    for name, (kind, read) in _ENTRIES.items():
        value = announced.get(name)
        if value is not None:
            try:
                entries[name] = read(value)
            except TypeError:
                raise AnnouncementError(f"{name} must be {kind}, got {type(value).__name__}", name) from None
    return entries


def differences(policy: Announcement, environment: Announcement) -> list[dict[str, Any]]:
    """Return the mismatches of policy and environment: maps with `field`, `policy`, `environment` and `message`."""
    checks = (_compare_choices, _compare_rates, _compare_inputs, _compare_images)
    return [
        {"field": field, "policy": required, "environment": offered, "message": message}
        for check in checks
        for field, required, offered, message in check(policy, environment)
    ]


_Difference = tuple[str, Any, Any, str]
"""Field, value of the policy, value of the environment, message."""


def _compare_choices(policy: Announcement, environment: Announcement) -> Iterator[_Difference]:
    """Compare embodiment and action type with the policy's configuration and manifest."""
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


def _compare_rates(policy: Announcement, environment: Announcement) -> Iterator[_Difference]:
    required, offered = policy.get(_FREQUENCY), environment.get(_FREQUENCY)
    if None not in (required, offered) and required != offered:
        text = f"the policy's actions are meant for {required} Hz, the environment executes them at {offered} Hz"
        yield _FREQUENCY, required, offered, text


def _compare_inputs(policy: Announcement, environment: Announcement) -> Iterator[_Difference]:
    required, offered = policy.get(_INPUTS), environment.get(_INPUTS)
    if isinstance(required, list) and isinstance(offered, list):
        missing = [name for name in required if name not in offered]
        if missing:
            yield _INPUTS, required, offered, f"the environment does not offer {', '.join(map(str, missing))}"


def _compare_images(policy: Announcement, environment: Announcement) -> Iterator[_Difference]:
    """Compare the image sizes of the environment with those that the policy needs."""
    needed, provided = policy.get(_CAMERAS), environment.get(_CAMERAS)
    if not isinstance(needed, Mapping) or not isinstance(provided, Mapping):
        return
    for camera, need in needed.items():
        image = provided.get(camera)
        if isinstance(need, Mapping) and isinstance(image, Mapping) and not _is_large_enough(need, image):
            size = " x ".join(str(need.get(side) or "any") for side in _SIDES)
            least = "" if need.get(_EXACT) else " or larger"
            got = " x ".join(str(image.get(side)) for side in _SIDES)
            yield _CAMERAS, needed, provided, f"the policy needs {camera} {size}{least}, the environment has {got}"


def _is_large_enough(need: Mapping[str, Any], image: Mapping[str, Any]) -> bool:
    """Return whether an image has a size that the policy accepts."""
    sizes = [(need.get(side), image.get(side)) for side in _SIDES]
    comparable = [
        (required, offered) for required, offered in sizes if isinstance(required, int) and isinstance(offered, int)
    ]
    return all(offered == required if need.get(_EXACT) else offered >= required for required, offered in comparable)


def format_differences(mismatches: list[dict[str, Any]]) -> str:
    """Return the mismatches as one sentence."""
    return "policy and environment do not fit: " + "; ".join(str(one["message"]) for one in mismatches)


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError
    return str(value)


def _number(value: object) -> float | int:
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise TypeError
    return int(value) if isinstance(value, numbers.Integral) else float(value)


def _flag(value: object) -> bool:
    if type(value) is not bool:
        raise TypeError
    return value


def _texts(value: object) -> list[str]:
    if not isinstance(value, (list, tuple)):
        raise TypeError
    return [_text(item) for item in value]


def _sizes(value: object) -> dict[str, dict[str, Any]]:
    if not isinstance(value, Mapping):
        raise TypeError
    return {_text(camera): _size(image) for camera, image in value.items()}


def _size(value: object) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise TypeError
    sides = {side: _number(value[side]) for side in _SIDES if value.get(side) is not None}
    return {**sides, **({_EXACT: True} if value.get(_EXACT) is True else {})}


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
