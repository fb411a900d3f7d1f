"""Observations with one input changed or left out, named as in a manifest (`instruction`, `vision.cam_head`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from xpl import _spec as sdk

_POSES = (sdk.State.EE_POSE, sdk.State.TCP_POSE)


def varied(obs: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the observation with one input changed, `name` as in the manifest (`instruction`, `vision.cam_head`)."""
    group, _, leaf = name.partition(".")
    if group == sdk.Obs.INSTRUCTION:
        return {**obs, group: "do something else entirely, quickly"}
    if group == sdk.Obs.VISION:
        camera = obs[group][leaf]
        image = camera[sdk.Camera.COLOR]
        other = np.ascontiguousarray(255 - image[::-1, :, ::-1])
        return {**obs, group: {**obs[group], leaf: {**camera, sdk.Camera.COLOR: other}}}
    state = {key: _nudged(key, value) if key.endswith(leaf) else value for key, value in obs[group].items()}
    return {**obs, group: state}


def without(obs: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the observation without one input, `name` as in the manifest."""
    group, _, leaf = name.partition(".")
    if not leaf:
        return {key: value for key, value in obs.items() if key != group}
    return {**obs, group: {key: value for key, value in obs[group].items() if not key.endswith(leaf)}}


def _nudged(key: str, value: Any) -> Any:
    if not key.endswith(_POSES):
        return value * 0.9 + 0.02
    moved = np.array(value)
    moved[: sdk.POSITION_DIM] += 0.02
    return moved
