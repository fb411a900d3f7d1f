"""`openpi` of deploy.yml: a style of openpi's examples, additional names, gripper scale and image layout.

    openpi: {style: droid, names: {observation/exterior_image_2_left: null}, gripper: {closed: 1, open: 0}, images: hwc}

`null` marks a name that is not used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.policy import ConfigError

KEY = "openpi"
"""The key of deploy.yml."""
LAYOUTS = ("hwc", "chw")
"""Orders of an image's axes; the first is the default."""

_CLOSED, _OPEN = "closed", "open"
_STATE, _VISION, _INSTRUCTION = spec.Obs.STATE, spec.Obs.VISION, spec.Obs.INSTRUCTION
_HEAD, _WRIST = (f"{_VISION}.{camera}" for camera in spec.CAMERAS[1])
_TOP, _LEFT, _RIGHT = (f"{_VISION}.{camera}" for camera in spec.CAMERAS[2])
_THIRD = f"{_VISION}.{spec.OPTIONAL_CAMERAS[0]}"

STYLES: dict[str, dict[str, Any]] = {
    "droid": {
        "names": {
            "observation/exterior_image_1_left": _HEAD,
            "observation/wrist_image_left": _WRIST,
            "observation/joint_position": f"{_STATE}.{spec.State.ARM_JOINT_STATE}",
            "observation/gripper_position": f"{_STATE}.{spec.State.EE_JOINT_STATE}",
            "prompt": _INSTRUCTION,
        },
        "gripper": {_CLOSED: 1.0, _OPEN: 0.0},
    },
    "libero": {
        "names": {
            "observation/image": _HEAD,
            "observation/wrist_image": _WRIST,
            "observation/state": _STATE,
            "prompt": _INSTRUCTION,
        },
    },
    "aloha": {
        "names": {
            "images.cam_high": _TOP,
            "images.cam_low": _THIRD,
            "images.cam_left_wrist": _LEFT,
            "images.cam_right_wrist": _RIGHT,
            _STATE: _STATE,
            "prompt": _INSTRUCTION,
        },
        "images": "chw",
    },
}
"""Inputs of openpi's example policies: policies/droid_policy.py, libero_policy.py and aloha_policy.py there."""


def read(config: Any) -> dict[str, Any]:
    """Return `openpi` of deploy.yml with the settings of its style: `names`, and `gripper` and `images` if set.

    Raises:
        ConfigError: it is missing or invalid.
    """
    styles = ", ".join(STYLES)
    if config is None:
        raise ConfigError(
            f"openpi's wire has no names of the standard: set `{KEY}` in deploy.yml, which maps its names to inputs, "
            f"for example {{style: droid}}; styles are {styles}"
        )
    keys = ("style", "names", "gripper", "images")
    unknown = [str(key) for key in config if key not in keys] if isinstance(config, Mapping) else [repr(config)]
    if unknown:
        raise ConfigError(f"{KEY} in deploy.yml takes {', '.join(keys)}; got {', '.join(unknown)}")
    style, names = config.get("style"), config.get("names") or {}
    if style is not None and style not in STYLES:
        raise ConfigError(f"{KEY}.style must be one of {styles}, got {style!r}")
    if not isinstance(names, Mapping) or not all(isinstance(name, str) for name in names):
        raise ConfigError(f"{KEY}.names must map openpi's names to inputs, got {names!r}")
    base: dict[str, Any] = STYLES[style] if style is not None else {"names": {}}
    settings = {**base, **{key: value for key, value in config.items() if value is not None}}
    # A name in deploy.yml replaces the style's name for the same input.
    kept = {name: target for name, target in base["names"].items() if target not in names.values()}
    settings["names"] = {**kept, **names}
    if not any(settings["names"].values()):
        raise ConfigError(f"{KEY} in deploy.yml needs a style ({styles}) or names")
    if settings.get("images", LAYOUTS[0]) not in LAYOUTS:
        raise ConfigError(f"{KEY}.images must be one of {', '.join(LAYOUTS)}, got {settings['images']!r}")
    return settings


def gripper_ends(value: object) -> tuple[float, float]:
    """Return the values of a closed and of an open gripper.

    Raises:
        ConfigError: the setting has not two different finite numbers.
    """
    if value is None:
        return spec.GRIPPER_CLOSED, spec.GRIPPER_OPEN
    ends = [value.get(key) for key in (_CLOSED, _OPEN)] if isinstance(value, Mapping) and len(value) == 2 else []
    numbers = [float(end) for end in ends if isinstance(end, (int, float)) and not isinstance(end, bool)]
    if len(numbers) != 2 or numbers[0] == numbers[1] or not np.isfinite(numbers).all():
        raise ConfigError(f"{KEY}.gripper must be {{closed: NUMBER, open: another NUMBER}}, got {value!r}")
    return numbers[0], numbers[1]
