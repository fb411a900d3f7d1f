"""Episodes of one environment: the class that an author implements, and its runner."""

from __future__ import annotations

import functools
import hashlib
import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.action import ActionError
from xpl.safety import NON_FINITE, SafetyVerdict, Supervisor

if TYPE_CHECKING:
    from xpl.contract import Action, Entry, ObservationDict, Report, Result, State
    from xpl.embodiment import Embodiment
    from xpl.manifest import EnvManifest

SUCCESS, MAX_STEPS, NON_FINITE_STATE = "success", "max_steps", "non_finite_state"
SUCCESS_SCORE = 1.0
END_REASON, CORRECTIONS = "end_reason", "corrections"
_FLOAT64, _FLOAT32 = np.dtype(np.float64), np.dtype(np.float32)

Corrections = dict[str, dict[str, float]]
"""Differences between commanded and executed action of one control step: largest amount by arm prefix and kind.

An arm whose command was executed unchanged is left out. Kinds are those of `xpl.safety.Correction` and of the
environment.
"""


@dataclass(frozen=True)
class Setup:
    """The checked configuration of an environment, with env.yml.

    Attributes:
        task: a task of env.yml.
        embodiment: the robot.
        action_type: "joint" or "ee".
        max_steps: control steps after which an episode ends.
        cameras: True for images of the environment's default size, False for none, or (height, width) in pixels.
        privileged: whether observations contain the simulator's ground truth.
        setting: a setting of env.yml.
        manifest: env.yml.
    """

    task: str
    embodiment: Embodiment
    action_type: str
    max_steps: int
    cameras: bool | tuple[int, int]
    privileged: bool
    setting: str
    manifest: EnvManifest

    @property
    def facts(self) -> Entry:
        """The task's entry of env.yml as written, with keys that only this environment reads."""
        return self.manifest.tasks[self.task].data

    @property
    def frequency(self) -> float:
        """Control rate, Hz: the task's own, or the environment's."""
        return self.manifest.frequency(self.task)


@dataclass(frozen=True)
class Simulated:
    """A simulator's own observation and command, before any conversion.

    Attributes:
        observation: the simulator's current observation.
        command: (N,) its command of the last control step, in its own units and order; None before the first.
    """

    observation: Any
    command: Any = None


class Episode(ABC):
    """A simulator with one robot and one task; the author of an environment implements it.

    One object runs many episodes in sequence; `reset` clears all state. Actions are checked and within the robot's
    limits.

    Args:
        setup: the checked configuration.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Begin an episode; the seed alone determines all that is random."""

    @abstractmethod
    def state(self) -> State:
        """Return the robot's state: keys, shapes and units of the standard's `state`."""

    @abstractmethod
    def step(self, action: Action) -> Mapping[str, Mapping[str, float]] | None:
        """Execute one action step for one control period.

        Args:
            action: targets, float32 arrays by the keys of the action type.

        Returns:
            Corrections besides the robot's own limits: amount by arm prefix and kind; None for none.
        """

    @abstractmethod
    def score(self) -> float:
        """Return the progress of the task, 0..1; 1 is success and ends the episode."""

    @property
    def instruction(self) -> str:
        """The task in words; that of env.yml unless overridden."""
        return str(self.setup.facts[spec.Obs.INSTRUCTION])

    def vision(self) -> Mapping[str, Mapping[str, Any]]:
        """Return the current image of each camera; not called if the configuration has no cameras."""
        return {}

    def truth(self) -> Mapping[str, Any]:
        """Return the ground truth that a policy cannot observe, such as object poses: numbers, text, arrays, maps.

        Part of privileged observations, and of the digest.
        """
        return {}

    def end_reason(self) -> str | None:
        """Return the reason why the episode ends, other than success and the step limit; None if it goes on."""
        return None

    def simulated(self) -> Simulated | None:
        """Return the simulator's own observation and command, for `xpl.bridge`; None if they are not available.

        Both must be unconverted: the authors' client reads the observation and returns such a command.
        """
        return None

    def close(self) -> None:  # noqa: B027 - most have nothing to release
        """Release the simulator's resources."""


class EpisodeRunner:
    """Runs the episodes of one environment: limits actions, counts steps and corrections, ends episodes.

    Args:
        episode: the author's episode.
        env_idx: index of the environment.
    """

    def __init__(self, episode: Episode, env_idx: int) -> None:
        self._episode, self._env_idx = episode, env_idx
        setup = episode.setup
        self._frequency = setup.frequency
        # The author chooses the start pose, and a simulator accepts any first command.
        self._safety = Supervisor(
            setup.embodiment,
            setup.action_type,
            setup.frequency,
            first_steps=math.inf,
            fastest=setup.manifest.fastest,
        )

    def reset(self, seed: int) -> None:
        """Begin an episode."""
        self._episode.reset(seed)
        self._seed, self._steps, self._score = seed, 0, 0.0
        self._corrections: Counter[str] = Counter()
        self._digest = hashlib.sha256()
        self.end_reason: str | None = None
        state = self._episode.state()
        self._safety.begin({spec.Obs.STATE: state})
        self._add_to_digest(state)

    def observe(self) -> ObservationDict:
        """Return the current observation, a new map that the caller may change."""
        episode, setup = self._episode, self._episode.setup
        result: ObservationDict = {
            spec.Obs.DATA_FORMAT_VERSION: spec.DATA_FORMAT_VERSION,
            spec.Obs.INSTRUCTION: episode.instruction,
            spec.Obs.ENV_IDX: self._env_idx,
            spec.Obs.ADDITIONAL_INFO: {spec.Obs.FREQUENCY: self._frequency},
            spec.Obs.VISION: dict(episode.vision()) if setup.cameras else {},
            spec.Obs.STATE: {key: np.array(value, dtype=_FLOAT32) for key, value in episode.state().items()},
        }
        if setup.privileged:
            result[spec.Obs.PRIVILEGED] = dict(episode.truth())
        return result

    def step(self, action: Action) -> Report:
        """Execute one action step, unless the episode has ended; return the step's report.

        Raises:
            ActionError: the step does not fit embodiment and action type. Nothing was executed.
        """
        if not isinstance(action, Mapping):
            raise ActionError(f"an action step must be a map of arrays, got {type(action).__name__}")
        if self.end_reason is not None:
            self._safety.read(action)
            return self._report({})
        verdict = self._safety.check(action)
        if verdict.hold_reason == NON_FINITE:
            # Not passed to the simulator: a NaN in a command spreads through the whole state.
            self.end_reason = NON_FINITE
            return self._report({})
        corrections = _by_arm(verdict)
        step = {key: np.asarray(value, dtype=_FLOAT32) for key, value in verdict.action.items()}
        for prefix, extra in (self._episode.step(step) or {}).items():
            corrections.setdefault(prefix, {}).update(extra)
        self._steps += 1
        state = self._episode.state()
        self._add_to_digest(state)
        self._update_outcome(state)
        if corrections:
            self._corrections.update(kind for kinds in corrections.values() for kind in kinds)
        return self._report(corrections)

    def vision(self) -> dict[str, Mapping[str, Any]]:
        """Return the current image of each camera, also if observations have none."""
        return dict(self._episode.vision())

    def simulated(self) -> Simulated | None:
        """Return the simulator's own observation and command; None if they are not available."""
        return self._episode.simulated()

    def result(self) -> Result:
        """Return the episode's outcome so far, as plain values."""
        return {
            spec.Obs.ENV_IDX: self._env_idx,
            "task": self._episode.setup.task,
            spec.Deploy.SEED: self._seed,
            spec.Obs.INSTRUCTION: self._episode.instruction,
            "success": self.end_reason == SUCCESS,
            "score": self._score,
            "steps": self._steps,
            END_REASON: self.end_reason,
            CORRECTIONS: dict(self._corrections),
            "digest": self._digest.hexdigest(),
        }

    def close(self) -> None:
        """Release the simulator's resources."""
        self._episode.close()

    def _add_to_digest(self, state: State) -> None:
        """Add the current state and ground truth to the digest."""
        self._digest.update(b"".join((*_digest_parts(state), *_digest_parts(self._episode.truth()))))

    def _update_outcome(self, state: State) -> None:
        self._score = min(max(float(self._episode.score()), 0.0), SUCCESS_SCORE)
        if not _is_finite(state):
            self.end_reason = NON_FINITE_STATE
        elif self._score >= SUCCESS_SCORE:
            self.end_reason = SUCCESS
        else:
            self.end_reason = self._episode.end_reason()
            if self.end_reason is None and self._steps >= self._episode.setup.max_steps:
                self.end_reason = MAX_STEPS

    def _report(self, corrections: Corrections) -> Report:
        return {
            spec.Obs.ENV_IDX: self._env_idx,
            "step": self._steps,
            END_REASON: self.end_reason,
            CORRECTIONS: corrections,
        }


def _by_arm(verdict: SafetyVerdict) -> Corrections:
    result: Corrections = {}
    for correction in verdict.corrections:
        kinds = result.setdefault(correction.prefix, {})
        kinds[correction.kind] = max(correction.amount, kinds.get(correction.kind, 0.0))
    return result


def _is_finite(state: State) -> bool:
    # Faster than numpy for so few numbers.
    for value in state.values():  # noqa: SIM110 - a generator costs as much as the rest
        if not all(map(math.isfinite, np.asarray(value).ravel().tolist())):
            return False
    return True


def _digest_parts(value: object) -> list[bytes]:
    """Return the bytes of a value in a digest: maps by sorted keys, numbers and arrays as float64, others by item."""
    if isinstance(value, Mapping):
        parts: list[bytes] = []
        for key in sorted(value):
            part = value[key]
            parts.append(_digest_key(key))
            if type(part) is np.ndarray and part.dtype is _FLOAT64:  # what most are
                parts += (_digest_key(part.shape), part.tobytes())
            else:
                parts += _digest_parts(part)
        return parts
    array = np.asarray(value)
    if array.dtype.kind in "biuf":
        return [_digest_key(array.shape), array.astype(np.float64).tobytes()]
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        return [each for part in value for each in _digest_parts(part)]
    return [f"{value}\0".encode()]


@functools.lru_cache(maxsize=1024, typed=True)
def _digest_key(value: Hashable) -> bytes:
    """Return the bytes of a key or a shape in a digest; cached, because they repeat at every control step."""
    return f"{value}\0".encode()
