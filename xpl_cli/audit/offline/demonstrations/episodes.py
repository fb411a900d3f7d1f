"""Recorded episodes as a session of questions, with the recorded actions after each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import _spec as sdk
from xpl import poses
from xpl.conventions.frame import mount
from xpl.convert import ConversionError
from xpl.kinematics import Chain, KinematicsError
from xpl_cli.audit.offline.search.session_replay import SessionReplay
from xpl_cli.model_io.pairs import PairSession
from xpl_cli.model_io.script import Call

if TYPE_CHECKING:
    from xpl.contract import Action, ObservationDict
    from xpl.embodiment import Embodiment
    from xpl.trajectory import Trajectory

_EPISODE: Final = 1 << 20
"""Indices of one episode: the index of an observation is `episode * _EPISODE + step`."""
_QUESTIONS: Final = 72
_LEAST, _MOST = 3, 10
"""Questions of all episodes together, and of each."""
_GOLDEN: Final = 0.6180339887498949
_BATCH: Final = 16
"""Questions of one batch."""
_MEMORY: Final = 64
"""Observations of an episode that are shown to a policy with a memory before its first question, at most."""


class MissingDataError(ValueError):
    """The episodes lack actions that the policy commands, or are of another robot."""


@dataclass(frozen=True)
class EpisodeRecording:
    """One episode.

    Attributes:
        trajectory: the file.
        commanded: recorded actions, (T, width) float64 by key of the action type.
        state: the same keys as they were observed.
    """

    trajectory: Trajectory
    commanded: Mapping[str, np.ndarray]
    state: Mapping[str, np.ndarray]

    @property
    def steps(self) -> int:
        """How many control steps it has."""
        return len(next(iter(self.commanded.values())))

    def commanded_from(self, step: int, horizon: int) -> list[dict[str, np.ndarray]]:
        """Return the recorded actions from a step on, until the horizon or the end of the episode."""
        until = min(step + horizon, self.steps)
        return [{key: rows[at] for key, rows in self.commanded.items()} for at in range(step, until)]


@dataclass(frozen=True)
class _RecordedScene:
    """Makes observations of recipes, as `xpl_cli.model_io.script.Scene` does of scripted ones."""

    recordings: Sequence[EpisodeRecording]

    def observation(self, env: int, index: int) -> ObservationDict:
        """Return an observation as a policy gets it."""
        recorded = self.recordings[index // _EPISODE].trajectory.observation(index % _EPISODE)
        return {**recorded, sdk.Obs.ENV_IDX: env}


@dataclass(frozen=True)
class RecordedSession(PairSession):
    """A session of recorded episodes; its answers are the recorded actions.

    Attributes:
        recordings: the episodes.
        question_steps: of each question the number of its episode and its step there.
    """

    recordings: tuple[EpisodeRecording, ...] = field(default=(), repr=False)
    question_steps: tuple[tuple[int, int], ...] = ()

    @cached_property
    def scene(self) -> Any:
        """What makes its observations."""
        return _RecordedScene(self.recordings)


class BatchedReplay(SessionReplay):
    """Replay of a session in which each question is an episode of its own, so that any subset can be asked.

    Questions are asked in batches, one environment for each.
    """

    def calls_for(self, numbers: Sequence[int]) -> list[Call]:
        """Return the calls that ask some questions."""
        calls = []
        for start in range(0, len(numbers), _BATCH):
            recipes_by_env = [self.session.questions[number].recipes for number in numbers[start : start + _BATCH]]
            longest = max(map(len, recipes_by_env))
            calls.append(Call(reset=True))
            for moment in range(longest):
                later = [moment - longest + len(recipes) for recipes in recipes_by_env]
                observed = [(env, recipes_by_env[env][at][1]) for env, at in enumerate(later) if at >= 0]
                calls.append(Call(show=tuple(observed)))
            calls.append(Call(ask=tuple(range(len(recipes_by_env)))))
        return calls


def load_recording(trajectory: Trajectory, robot: Embodiment, action_type: str) -> EpisodeRecording:
    """Return an episode with its actions in the keys of an action type.

    Poses are computed from recorded joint commands by the robot's kinematics.

    Raises:
        LackingError: neither was recorded, or the episode is of another robot.
        TrajectoryError: the file cannot be read.
    """
    recorded_robot = trajectory.episode.get("robot")
    if recorded_robot not in {None, robot.name}:
        raise MissingDataError(
            f"{trajectory.key} was recorded with {recorded_robot}, and the policy is served for {robot.name}: "
            f"--set {sdk.Deploy.ENV_CFG_TYPE}={recorded_robot}, if it was trained for that"
        )
    states = [dict(trajectory.observation(step)[sdk.Obs.STATE]) for step in (0, len(trajectory) - 1)]
    steps = [trajectory.action(step) for step in range(len(trajectory))]
    dims = robot.dims(action_type)
    commanded = {}
    for key, width in dims.items():
        values = _column(steps, key)
        if values is None and key.endswith(sdk.State.EE_POSE):
            values = _by_kinematics(steps, key, robot)
        if values is None or values.shape[1:] != (width,):
            recorded_text = "nothing" if values is None else f"{values.shape[1:]} numbers"
            raise MissingDataError(
                f"{trajectory.key} holds {recorded_text} of action/{key}, and the policy commands ({width},)"
            )
        commanded[key] = values
    lacking = sorted(key for key in dims if any(key not in one for one in states))
    if lacking:
        raise MissingDataError(
            f"{trajectory.key} lacks state/{', state/'.join(lacking)}, which the baseline of holding the pose needs"
        )
    state = {key: _states(trajectory, key) for key in dims}
    return EpisodeRecording(trajectory, commanded, state)


def make_session(  # noqa: PLR0913, PLR0917 - what is served, and how far it looks
    recordings: Sequence[EpisodeRecording], robot: Embodiment, action_type: str, seed: int, horizon: int, span: int
) -> RecordedSession:
    """Return questions over episodes, each after a reset and the observations that its history reaches over.

    Args:
        recordings: the episodes.
        robot: that is served.
        action_type: likewise.
        seed: likewise.
        horizon: action steps of a chunk that are compared.
        span: control steps that the policy's history reaches over, 1 without one; 0 for a memory, which is shown the
            episode from its beginning, and asked once.
    """
    calls: list[Call] = []
    answers: list[tuple[dict[str, np.ndarray], ...]] = []
    question_steps: list[tuple[int, int]] = []
    per_episode = max(_LEAST, min(_MOST, _QUESTIONS // len(recordings)))
    for number, episode in enumerate(recordings):
        for step in _steps(episode.steps, per_episode, (number * _GOLDEN) % 1.0):
            first = max(0, step - (_MEMORY if span == 0 else span) + 1)
            calls.append(Call(reset=True))
            calls += [Call(show=((0, number * _EPISODE + at),)) for at in range(first, step + 1)]
            calls.append(Call(ask=(0,)))
            commanded = episode.commanded_from(step, horizon)
            answers.append(({key: np.stack([one[key] for one in commanded])[None] for key in commanded[0]},))
            question_steps.append((number, step))
    return RecordedSession(
        embodiment=robot.name,
        action_type=action_type,
        seed=seed,
        cameras={},
        takes=1,
        calls=tuple(calls),
        answers=tuple(answers),
        recordings=tuple(recordings),
        question_steps=tuple(question_steps),
    )


def select_few(question_steps: Sequence[tuple[int, int]]) -> list[int]:
    """Return the questions on which changes are tried first: one of each episode, at different phases; at most 12.

    With few episodes there are eight, so that they cover all phases of an episode.
    """
    by_episode: dict[int, list[int]] = {}
    for number, (episode, _) in enumerate(question_steps):
        by_episode.setdefault(episode, []).append(number)
    numbers_found = set()
    for pick in range(max(8, min(12, len(by_episode)))):
        numbers = list(by_episode.values())[pick % len(by_episode)]
        numbers_found.add(numbers[int(len(numbers) * ((pick * _GOLDEN) % 1.0))])
    return sorted(numbers_found)


def _steps(length: int, count: int, phase: float) -> Iterator[int]:
    """Yield steps that are evenly spread over an episode, shifted by a phase."""
    steps = [int((number + phase) * (length - 1) / count) for number in range(count)]
    yield from dict.fromkeys(steps)


def _column(steps: Sequence[Action], key: str) -> np.ndarray | None:
    if any(key not in step for step in steps):
        return None
    return np.stack([np.asarray(step[key], np.float64) for step in steps])


def _states(trajectory: Trajectory, key: str) -> np.ndarray:
    from xpl.trajectory.names import stored_path

    rows = np.asarray(trajectory.rows("/".join(stored_path((sdk.Obs.STATE, key)))), np.float64)
    return rows[:, None] if rows.ndim == 1 else rows


def _by_kinematics(steps: Sequence[Action], key: str, robot: Embodiment) -> np.ndarray | None:
    """Return the flange's poses in the world that commanded joints lead to, None where that is not known."""
    prefix = key.removesuffix(sdk.State.EE_POSE)
    joints = _column(steps, prefix + sdk.State.ARM_JOINT_STATE)
    side = dict(zip(robot.prefixes, robot.data["arms"], strict=True))[prefix]
    if joints is None:
        return None
    try:
        chain, base = Chain.from_embodiment(robot.data), mount(robot, side)
    except (KinematicsError, ConversionError):
        return None
    return np.stack([poses.compose(base, chain.flange(row)) for row in joints])
