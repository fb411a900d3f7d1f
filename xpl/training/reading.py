"""Training windows: recorded episodes encoded by an adapter without its model."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.history import History
from xpl.manifest import Manifest
from xpl.policy import Policy
from xpl.training.adapters import TrainingError, manifest_of, without_model
from xpl.training.windows import Pixels, Values, Windows

if TYPE_CHECKING:
    from xpl.contract import Action, Config, ObservationDict
    from xpl.convert import Interface
    from xpl.trajectory import Folder, Trajectory


def windows(
    folder: str | os.PathLike[str],
    config: Config,
    demonstrations: Folder,
    *,
    horizon: int | None = None,
    first: int = 0,
) -> Windows:
    """Return the training windows of a data set, one per control step.

    Images are decoded once. They stay uint8 if only range, mean and std follow (`Windows.pixels` then applies those),
    and are float32 otherwise.

    Args:
        folder: folder of the package.
        config: configuration of the run (`$XPL_CONFIG`); its checkpoint, or the package, has the statistics of
            `model_io.normalize`.
        demonstrations: the data set, in the standard's format; `xpl data convert` converts others.
        horizon: action horizon H, steps; by default that of block and manifest.
        first: control step of the first action relative to the newest observation; -1 for a model that also predicts
            the previous action.

    Returns:
        N windows, one per control step.

    Raises:
        TrainingError: the data set does not fit the adapter: another robot, other actions, no steps.
        ConversionError: the block does not fit the robot, or statistics are missing.
    """
    policy = without_model(folder, config)
    with_bytes = without_model(folder, config, as_bytes=True)
    secrets = uses_privileged(folder, config)
    pixels = _pixels([RecordedSet(one, demonstrations, secrets) for one in (policy, with_bytes)])
    recorded = RecordedSet(with_bytes if pixels is not None else policy, demonstrations, secrets)
    return read_all(recorded, horizon, first, pixels)


@dataclass(frozen=True)
class RecordedSet:
    """A data set, and the adapter without its model that encodes it.

    Attributes:
        policy: the adapter.
        demonstrations: the data set.
        secrets: whether observations include `privileged` if recorded.
    """

    policy: Policy
    demonstrations: Folder
    secrets: bool

    def observation(self, episode: Trajectory, step: int) -> ObservationDict:
        """Return an observation as the adapter would get it."""
        obs = episode.observation(step, _cameras(self.policy))
        if not self.secrets:
            obs.pop(spec.Obs.PRIVILEGED, None)
        return {**obs, spec.Obs.ENV_IDX: 0}


def uses_privileged(folder: str | os.PathLike[str], config: Config) -> bool:
    """Return whether an adapter's manifest declares privileged observations as input."""
    inputs = Manifest.parse(manifest_of(folder, config)).inputs
    return inputs is not None and spec.Obs.PRIVILEGED in (*inputs.required, *inputs.optional)


def read_all(
    recorded: RecordedSet, horizon: int | None, first: int, pixels: Mapping[str, Pixels] | None = None
) -> Windows:
    """Return the windows of all episodes.

    Args:
        recorded: data set and adapter.
        horizon: see `windows`.
        first: see `windows`.
        pixels: by input, the scaling of images that stay uint8.

    Returns:
        N windows, one per control step.
    """
    policy, demonstrations = recorded.policy, recorded.demonstrations
    interface = _interface(policy)
    height = interface.action.first + (interface.action.steps or 1) if horizon is None else horizon
    own = type(policy).encode is not Policy.encode
    rows: list[Mapping[str, Any]] = []
    targets, padded, counts = [], [], []
    for episode in demonstrations:
        with episode:
            _check_robot(episode, policy)
            encoded_steps, actions = _encode_episode(recorded, episode)
        count = len(encoded_steps)
        if not count:
            raise TrainingError(f"{episode.path} has no control steps")
        states = [obs[spec.Obs.STATE] for obs, _ in encoded_steps]
        indices = np.arange(count)[:, None] + np.arange(height) + first
        targets.append(_answers(interface, actions, states, np.clip(indices, 0, count - 1)))
        padded.append((indices < 0) | (indices >= count))
        rows += [encoded for _, encoded in encoded_steps]
        counts.append(count)
    if not rows:
        raise TrainingError(f"{demonstrations.path} holds no episode")
    inputs = {name: _column(name, [row[name] for row in rows]) for name in rows[0]}
    starts = np.cumsum([0, *counts], dtype=np.int64)
    alike = History(length=policy.history) if own else None  # history of an adapter with its own `encode`
    histories = {name: alike or interface.history_of(name) for name in inputs}
    return Windows(
        inputs=inputs,
        pixels=dict(pixels or {}),
        targets=np.concatenate(targets).astype(np.float32),
        padded=np.concatenate(padded),
        history_rows={
            name: _history_rows(one, starts) for name, one in histories.items() if one is not None and one.length > 1
        },
        real={name: _history_mask(alike or one, starts) for name, one in interface.masks.items()},
        starts=starts,
    )


def _history_rows(history: History, starts: np.ndarray) -> np.ndarray:
    """Return (N, T) int64: row indices of each control step's history; -1 for zero padding."""
    rows, first = _rows_of_history(history, starts)
    return np.where(rows < first, -1 if history.pads_with_zeros else first, rows)


def _history_mask(history: History, starts: np.ndarray) -> np.ndarray:
    """Return (N, T) float32: 1 for observations of the episode, 0 for padding."""
    rows, first = _rows_of_history(history, starts)
    return (rows >= first).astype(np.float32)


def _rows_of_history(history: History, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the row indices (N, T) of a history without padding, and the first row (N, 1) of each episode."""
    first = np.repeat(starts[:-1], np.diff(starts))[:, None]
    return np.arange(starts[-1])[:, None] - np.array(history.ages), first


def _interface(policy: Policy) -> Interface:
    if policy.interface is None:
        raise TrainingError(f"{type(policy).__name__} has no block model_io, which converts actions to the model's")
    if type(policy).decode is not Policy.decode:
        raise TrainingError(
            f"{type(policy).__name__} has its own decode, which has no inverse; "
            "declare the conversion in model_io.action"
        )
    return policy.interface


def _check_robot(episode: Trajectory, policy: Policy) -> None:
    robot = episode.episode.get("embodiment")
    if robot is not None and robot != policy.embodiment.name:
        raise TrainingError(
            f"{episode.path} was recorded with {robot}, and env_cfg_type is {policy.embodiment.name}: "
            "train with --set env_cfg_type of the set"
        )


def _encode_episode(
    recorded: RecordedSet, episode: Trajectory
) -> tuple[list[tuple[Mapping[str, Any], Mapping[str, Any]]], list[Mapping[str, Any]]]:
    """Return (state, result of `encode`) of each observation, and each action."""
    policy = recorded.policy
    keys = policy.embodiment.dims(policy.action_type)
    encoded_steps: list[tuple[Mapping[str, Any], Mapping[str, Any]]] = []
    actions: list[Action] = []
    policy.reset()
    for step in range(len(episode)):
        obs = recorded.observation(episode, step)
        action = episode.action(step)
        lacking = [key for key in keys if key not in action]
        if lacking:
            raise TrainingError(
                f"{episode.path} has no {', '.join(lacking)} in its actions, which {policy.action_type} control needs; "
                f"it has {', '.join(action) or 'none'}: train with the action_type of the set"
            )
        policy.update_obs(obs)
        encoded = policy.encodings(0)[-1]
        if not isinstance(encoded, Mapping):
            raise TrainingError(
                f"encode of {type(policy).__name__} returned {type(encoded).__name__}, expected a map of named inputs"
            )
        state = {spec.Obs.STATE: obs[spec.Obs.STATE]}  # images need not be kept
        encoded_steps.append((state, encoded))
        actions.append(action)
    return encoded_steps, actions


def _cameras(policy: Policy) -> list[str] | None:
    """Return the cameras of the block's images; None for all, if the adapter has its own `encode`."""
    if type(policy).encode is not Policy.encode or policy.interface is None:
        return None
    return [camera for item in policy.interface.images for camera in item.cameras]


def _answers(interface: Interface, actions: Sequence[Action], states: Sequence[Any], indices: np.ndarray) -> np.ndarray:
    """Return the model outputs (T, H, D) of the actions at `indices` (T, H), each relative to the state of its step."""
    output = interface.action
    if not output.is_relative:
        each: np.ndarray = output.encode(actions, states[0], {})[output.first :][indices]
        return each
    made = []
    for step, chosen in enumerate(indices):
        memory: dict[str, np.ndarray] = {}
        if step:
            output.encode([actions[step - 1]], states[step - 1], memory)  # deltas start from the previous command
        answer = output.encode([actions[place] for place in chosen], states[step], memory)
        made.append(answer[output.first :])
    return np.stack(made)


def _column(name: str, values: Sequence[Any]) -> Values:
    if isinstance(values[0], str):
        return list(values)
    shapes = {np.shape(value) for value in values}
    if len(shapes) > 1:
        raise TrainingError(
            f"input {name} has rows of several shapes in this set: {', '.join(map(str, sorted(shapes)))}; "
            "add a resize to model_io.images, or train on episodes that are alike"
        )
    return np.stack(values)


def _pixels(sets: Sequence[RecordedSet]) -> dict[str, Pixels] | None:
    """Return the scaling of uint8 images by input, or None if the adapter needs float images.

    Both are compared at the first observation, because an adapter's own `encode` may change images.

    Args:
        sets: the data set with the adapter, and with the same adapter whose images stay uint8.
    """
    interface = _interface(sets[0].policy)
    scalings = {item.name: Pixels(*item.scaling) for item in interface.images if not item.is_bytes}
    if not scalings:
        return {}
    made = []
    for one in sets:
        with one.demonstrations[0] as episode:
            one.policy.reset()
            one.policy.update_obs(one.observation(episode, 0))
        made.append(one.policy.encodings(0)[-1])
        one.policy.reset()
    exact = all(
        name in made[1] and made[1][name].dtype == np.uint8 and _same(pixel.numbers(made[1][name]), made[0][name])
        for name, pixel in scalings.items()
    )
    return scalings if exact else None


def _same(one: np.ndarray, other: Any) -> bool:
    return one.dtype == np.asarray(other).dtype and np.array_equal(one, other)
