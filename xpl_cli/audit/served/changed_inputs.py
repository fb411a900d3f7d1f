"""Observations with one input changed or removed; inputs are named as in a manifest (`vision.cam_head`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from xpl.contract import Observation, ObservationDict, State

_POSES = (sdk.State.EE_POSE, sdk.State.TCP_POSE, sdk.State.DELTA_EE_POSE)
_NUDGE = 0.05
"""Change of one value, rad, m or share of a gripper's stroke: large for a policy, small for a robot's range."""


def present(obs: Observation) -> tuple[str, ...]:
    """Return the inputs that an observation holds."""
    leaves = {
        sdk.Obs.INSTRUCTION: [""] if sdk.Obs.INSTRUCTION in obs else [],
        sdk.Obs.VISION: list(obs.get(sdk.Obs.VISION, ())),
        sdk.Obs.STATE: list(dict.fromkeys(map(_leaf, obs.get(sdk.Obs.STATE, ())))),
    }
    return tuple(f"{group}.{leaf}" if leaf else group for group, names in leaves.items() for leaf in names)


def varied(obs: ObservationDict, name: str) -> ObservationDict:
    """Return the observation with one input changed, `name` as in the manifest (`instruction`, `vision.cam_head`)."""
    group, _, leaf = name.partition(".")
    if group == sdk.Obs.INSTRUCTION:
        return {**obs, group: "do something else entirely, and quickly"}
    if group == sdk.Obs.VISION:
        return _repainted(obs, leaf, lambda image: 255 - image[::-1, :, ::-1])
    return _moved(obs, {key: _nudged(key, obs[group][key]) for key in state_keys(obs, leaf)})


def state_keys(obs: Observation, leaf: str) -> list[str]:
    """Return the keys under which an observation holds one kind of state, one for each arm."""
    return [key for key in obs[sdk.Obs.STATE] if _leaf(key) == leaf]


def red_and_blue_exchanged(obs: ObservationDict, name: str) -> ObservationDict:
    """Return the observation with red and blue of one camera swapped."""
    return _repainted(obs, name.partition(".")[2], lambda image: image[:, :, ::-1])


def cameras_exchanged(obs: ObservationDict, first: str, second: str) -> ObservationDict:
    """Return the observation with the images of two cameras swapped."""
    names = [name.partition(".")[2] for name in (first, second)]
    pictures = [obs[sdk.Obs.VISION][name][sdk.Camera.COLOR] for name in names]
    changed = _repainted(obs, names[0], lambda _: pictures[1])
    return _repainted(changed, names[1], lambda _: pictures[0])


def sides_exchanged(obs: ObservationDict, name: str) -> ObservationDict:
    """Return the observation of two arms with one state field swapped between the arms."""
    left, right = state_keys(obs, name.partition(".")[2])
    state = obs[sdk.Obs.STATE]
    return _moved(obs, {left: state[right], right: state[left]})


def one_side_varied(obs: ObservationDict, key: str) -> ObservationDict:
    """Return the observation with the state of one arm changed."""
    return _moved(obs, {key: _nudged(key, obs[sdk.Obs.STATE][key])})


def values_nudged(obs: ObservationDict, key: str) -> Iterator[tuple[int, ObservationDict]]:
    """Yield each joint, gripper value or coordinate of a state by its index, with the observation in which it moved."""
    values = obs[sdk.Obs.STATE][key]
    for index in range(sdk.POSITION_DIM if _leaf(key) in _POSES else len(values)):
        other = np.array(values)
        other[index] += -_NUDGE if other[index] > 0.5 else _NUDGE
        yield index, _moved(obs, {key: other})


def antipodal(obs: ObservationDict) -> ObservationDict:
    """Return the observation with every quaternion negated: the same rotations."""
    state = obs[sdk.Obs.STATE]
    sign = np.where(np.arange(sdk.POSE_DIM) < sdk.POSITION_DIM, 1, -1).astype(np.float32)
    return _moved(obs, {key: state[key] * sign for leaf in _POSES for key in state_keys(obs, leaf)})


def turned(obs: ObservationDict, quaternion: np.ndarray) -> ObservationDict:
    """Return the observation with every end effector in one orientation, [qw, qx, qy, qz]."""
    keys = [key for leaf in (sdk.State.EE_POSE, sdk.State.TCP_POSE) for key in state_keys(obs, leaf)]
    state = obs[sdk.Obs.STATE]
    return _moved(
        obs, {key: np.concatenate([state[key][: sdk.POSITION_DIM], quaternion]).astype(np.float32) for key in keys}
    )


def with_gripper(obs: ObservationDict, key: str, value: float) -> ObservationDict:
    """Return the observation with the gripper of one arm at an opening."""
    return _moved(obs, {key: np.full_like(obs[sdk.Obs.STATE][key], value)})


def only(obs: ObservationDict, names: tuple[str, ...]) -> ObservationDict:
    """Return the observation with these inputs and the environment's index, and nothing else."""
    reduced = {key: value for key, value in obs.items() if key in {*names, sdk.Obs.ENV_IDX}}
    reduced[sdk.Obs.VISION] = {
        camera: {sdk.Camera.COLOR: entry[sdk.Camera.COLOR]}
        for camera, entry in obs[sdk.Obs.VISION].items()
        if f"{sdk.Obs.VISION}.{camera}" in names
    }
    reduced[sdk.Obs.STATE] = {
        key: value for key, value in obs[sdk.Obs.STATE].items() if f"{sdk.Obs.STATE}.{_leaf(key)}" in names
    }
    return reduced


def _leaf(key: str) -> str:
    """Return the kind of a state key, without the prefix of its arm."""
    sides = sdk.ARM_PREFIXES[2]
    return next((key.removeprefix(side) for side in sides if key.startswith(side)), key)


def _moved(obs: ObservationDict, values: State) -> ObservationDict:
    return {**obs, sdk.Obs.STATE: {**obs[sdk.Obs.STATE], **values}}


def _repainted(obs: ObservationDict, camera: str, paint: Callable[[np.ndarray], np.ndarray]) -> ObservationDict:
    vision = obs[sdk.Obs.VISION]
    picture = np.ascontiguousarray(paint(vision[camera][sdk.Camera.COLOR]))
    return {**obs, sdk.Obs.VISION: {**vision, camera: {**vision[camera], sdk.Camera.COLOR: picture}}}


def _nudged(key: str, value: np.ndarray) -> np.ndarray:
    if _leaf(key) not in _POSES:
        scaled: np.ndarray = value * 0.9 + 0.02
        return scaled
    moved = np.array(value)
    moved[: sdk.POSITION_DIM] += 0.02
    return moved
