"""Shows recorded episodes to an adapter without its model, and keeps what it makes of them."""

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
    """Return what an adapter's model is trained on: every control step of a set.

    Images are decoded once. They stay bytes where geometry, colours and layout make bytes of them (`Windows.pixels`
    then makes the numbers), and are float32 else.

    Args:
        folder: the package.
        config: of the run, as `$XPL_CONFIG` has it; its checkpoint, or the package, holds the numbers of
            `model_io.normalize`.
        demonstrations: the set, in the standard's form; `xpl data convert` brings others there.
        horizon: steps H of an answer; by default those that the block and the manifest hand on.
        first: which control step the answer begins with, counted from the newest observation: -1 for a model that also
            says what was done at the observation before.

    Raises:
        TrainingError: the set does not fit the adapter: another robot, other commands, no steps.
        ConversionError: the block does not fit the robot, or its numbers cannot be had.
    """
    policy = without_model(folder, config)
    terse = without_model(folder, config, as_bytes=True)
    secrets = is_told_secrets(folder, config)
    pixels = _pixels([Shown(one, demonstrations, secrets) for one in (policy, terse)])
    shown = Shown(terse if pixels is not None else policy, demonstrations, secrets)
    return read_all(shown, horizon, first, pixels)


@dataclass(frozen=True)
class Shown:
    """A set, and the adapter without its model that it is shown to.

    Attributes:
        policy: the adapter.
        demonstrations: the set.
        secrets: whether it is shown `privileged` where the set has it.
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


def is_told_secrets(folder: str | os.PathLike[str], config: Config) -> bool:
    """Tell whether an adapter's manifest asks for what only a simulator knows; else it is not served with it."""
    inputs = Manifest.parse(manifest_of(folder, config)).inputs
    return inputs is not None and spec.Obs.PRIVILEGED in (*inputs.required, *inputs.optional)


def read_all(asked: Shown, horizon: int | None, first: int, pixels: Mapping[str, Pixels] | None = None) -> Windows:
    """Return the windows of all episodes; arguments as of `windows`."""
    policy, demonstrations = asked.policy, asked.demonstrations
    interface = _interface(policy)
    height = interface.action.first + (interface.action.steps or 1) if horizon is None else horizon
    own = type(policy).encode is not Policy.encode
    rows: list[Mapping[str, Any]] = []
    targets, padded, counts = [], [], []
    for episode in demonstrations:
        with episode:
            _check_robot(episode, policy)
            shown, actions = _played(asked, episode)
        count = len(shown)
        if not count:
            raise TrainingError(f"{episode.path} has no control steps")
        states = [obs[spec.Obs.STATE] for obs, _ in shown]
        wanted = np.arange(count)[:, None] + np.arange(height) + first
        targets.append(_answers(interface, actions, states, np.clip(wanted, 0, count - 1)))
        padded.append((wanted < 0) | (wanted >= count))
        rows += [encoded for _, encoded in shown]
        counts.append(count)
    if not rows:
        raise TrainingError(f"{demonstrations.path} holds no episode")
    inputs = {name: _column(name, [row[name] for row in rows]) for name in rows[0]}
    starts = np.cumsum([0, *counts], dtype=np.int64)
    alike = History(length=policy.history) if own else None  # what predict gets of an adapter that encodes itself
    histories = {name: alike or interface.history_of(name) for name in inputs}
    return Windows(
        inputs=inputs,
        pixels=dict(pixels or {}),
        targets=np.concatenate(targets).astype(np.float32),
        padded=np.concatenate(padded),
        seen={name: _seen(one, starts) for name, one in histories.items() if one is not None and one.length > 1},
        real={name: _real(alike or one, starts) for name, one in interface.masks.items()},
        starts=starts,
    )


def _seen(history: History, starts: np.ndarray) -> np.ndarray:
    """Return (N, T) int64: for each control step the rows of its observations; -1 where zeros stand."""
    wanted, first = _wanted(history, starts)
    return np.where(wanted < first, -1 if history.pads_with_zeros else first, wanted)


def _real(history: History, starts: np.ndarray) -> np.ndarray:
    """Return (N, T) float32: 1 for each observation that is of the episode, else 0."""
    wanted, first = _wanted(history, starts)
    return (wanted >= first).astype(np.float32)


def _wanted(history: History, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows (N, T) that a history asks for, and the first row (N, 1) of the episode that each is of."""
    first = np.repeat(starts[:-1], np.diff(starts))[:, None]
    return np.arange(starts[-1])[:, None] - np.array(history.ages), first


def _interface(policy: Policy) -> Interface:
    if policy.interface is None:
        raise TrainingError(f"{type(policy).__name__} has no block model_io, by which actions become the model's")
    if type(policy).decode is not Policy.decode:
        raise TrainingError(
            f"{type(policy).__name__} decodes by code of its own, which has no inverse; "
            "say what it does in model_io.action"
        )
    return policy.interface


def _check_robot(episode: Trajectory, policy: Policy) -> None:
    robot = episode.episode.get("embodiment")
    if robot is not None and robot != policy.embodiment.name:
        raise TrainingError(
            f"{episode.path} was recorded with {robot}, and env_cfg_type is {policy.embodiment.name}: "
            "train with --set env_cfg_type of the set"
        )


def _played(
    asked: Shown, episode: Trajectory
) -> tuple[list[tuple[Mapping[str, Any], Mapping[str, Any]]], list[Mapping[str, Any]]]:
    """Return each observation with what `encode` made of it, and each action."""
    policy = asked.policy
    keys = policy.embodiment.dims(policy.action_type)
    shown: list[tuple[Mapping[str, Any], Mapping[str, Any]]] = []
    actions: list[Action] = []
    policy.reset()
    for step in range(len(episode)):
        obs = asked.observation(episode, step)
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
        shown.append((state, encoded))
        actions.append(action)
    return shown, actions


def _cameras(policy: Policy) -> list[str] | None:
    """Return the cameras that the block shows; None for all, where encode may read others."""
    if type(policy).encode is not Policy.encode or policy.interface is None:
        return None
    return [camera for item in policy.interface.images for camera in item.cameras]


def _answers(interface: Interface, actions: Sequence[Action], states: Sequence[Any], wanted: np.ndarray) -> np.ndarray:
    """Return the answers (T, H, D) that mean the wanted (T, H) of these actions, each asked for at its own state."""
    output = interface.action
    if not output.is_relative:
        each: np.ndarray = output.encode(actions, states[0], {})[output.first :][wanted]
        return each
    made = []
    for step, places in enumerate(wanted):
        memory: dict[str, np.ndarray] = {}
        if step:
            output.encode([actions[step - 1]], states[step - 1], memory)  # the command before is counted from
        answer = output.encode([actions[place] for place in places], states[step], memory)
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


def _pixels(asked: Sequence[Shown]) -> dict[str, Pixels] | None:
    """Return how bytes become numbers, by input, or None where an adapter needs the numbers themselves.

    Held against each other at the first observation: what an adapter's own `encode` does to images nobody knows.

    Args:
        asked: the adapter, and the same one with images as bytes.
    """
    interface = _interface(asked[0].policy)
    found = {item.name: Pixels(*item.scaling) for item in interface.images if not item.is_bytes}
    if not found:
        return {}
    made = []
    for one in asked:
        with one.demonstrations[0] as episode:
            one.policy.reset()
            one.policy.update_obs(one.observation(episode, 0))
        made.append(one.policy.encodings(0)[-1])
        one.policy.reset()
    exact = all(
        name in made[1] and made[1][name].dtype == np.uint8 and _same(pixel.numbers(made[1][name]), made[0][name])
        for name, pixel in found.items()
    )
    return found if exact else None


def _same(one: np.ndarray, other: Any) -> bool:
    return one.dtype == np.asarray(other).dtype and np.array_equal(one, other)
