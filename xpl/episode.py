"""One environment, one episode after the other: what an author writes, and the supervision around it."""

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
from xpl.safety import NON_FINITE, Supervisor, Verdict

if TYPE_CHECKING:
    from xpl.contract import Action, Entry, ObservationDict, Report, Result, State
    from xpl.embodiment import Embodiment
    from xpl.manifest import EnvManifest

SUCCESS, MAX_STEPS, NON_FINITE_STATE = "success", "max_steps", "non_finite_state"
SUCCESS_SCORE = 1.0
END_REASON, CORRECTIONS = "end_reason", "corrections"
_FLOAT64, _FLOAT32 = np.dtype(np.float64), np.dtype(np.float32)

Corrections = dict[str, dict[str, float]]
"""How commands differed from what was executed in one control step: by arm prefix, the largest amount of each kind.

An arm whose command was executed as given does not appear. Kinds are those of `xpl.safety.Correction` and the
environment's own.
"""


@dataclass(frozen=True)
class Setup:
    """What an environment plays: the configuration, checked, and the facts of env.yml that go with it.

    Attributes:
        task: a task of env.yml.
        embodiment: the robot.
        action_type: "joint" or "ee".
        max_steps: control steps after which an episode ends.
        cameras: True for pictures of the environment's own size, False for none, or (height, width).
        privileged: whether observations show the simulator's truth.
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
        """The task's entry of env.yml as it is written, with what only this environment reads."""
        return self.manifest.tasks[self.task].data

    @property
    def frequency(self) -> float:
        """Control steps per second: the task's own, or that of the environment."""
        return self.manifest.frequency(self.task)


@dataclass(frozen=True)
class Simulated:
    """What an environment's simulator says for itself, before anything is converted.

    Attributes:
        observation: what it observes now, as it gives it to anybody.
        command: (N,) what it was told in the last control step, in its own units and order; None before the first.
    """

    observation: Any
    command: Any = None


class Episode(ABC):
    """A simulator with one robot and one task: what the author of an environment writes.

    One object plays many episodes, one after the other; `reset` leaves nothing of the one before. Actions come checked
    and within the robot's limits.

    Args:
        setup: what is played.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Begin an episode; the seed alone decides everything that varies."""

    @abstractmethod
    def state(self) -> State:
        """Return the robot's state: keys, shapes and units of the standard's `state`."""

    @abstractmethod
    def step(self, action: Action) -> Mapping[str, Mapping[str, float]] | None:
        """Execute one action step for one control period.

        Args:
            action: targets, float32 arrays by the keys of the action type.

        Returns:
            what had to be changed besides the robot's own limits, by arm prefix and kind; None for nothing.
        """

    @abstractmethod
    def score(self) -> float:
        """Return how much of the task is done: 0 to 1, and 1 is success, which ends the episode."""

    @property
    def instruction(self) -> str:
        """The task in words; that of env.yml unless overridden."""
        return str(self.setup.facts[spec.Obs.INSTRUCTION])

    def vision(self) -> Mapping[str, Mapping[str, Any]]:
        """Return what each camera sees now; not called where nobody wants pictures."""
        return {}

    def truth(self) -> Mapping[str, Any]:
        """Return what a policy cannot know, such as poses of objects: numbers, texts, arrays, maps and lists of them.

        Shown where privileged observations are asked for, and part of the digest.
        """
        return {}

    def end_reason(self) -> str | None:
        """Return why the episode cannot go on, besides success and the step limit; None if it can."""
        return None

    def simulated(self) -> Simulated | None:
        """Return what the simulator says for itself, for a bridge (`xpl.bridge`); None if nobody can tell.

        Nothing of it may be converted: the authors' client of a policy reads the one and commands the other.
        """
        return None

    def close(self) -> None:  # noqa: B027 - most have nothing to release
        """Release what the simulator holds."""


class Referee:
    """Plays the episodes of one environment: bounds actions, counts steps, notes corrections, ends episodes, digests.

    Args:
        episode: the author's.
        env_idx: index of the environment.
    """

    def __init__(self, episode: Episode, env_idx: int) -> None:
        self._episode, self._env_idx = episode, env_idx
        setup = episode.setup
        self._frequency = setup.frequency
        # Where a robot starts is the author's choice, and a simulator may be told any pose.
        self._safety = Supervisor(setup.embodiment, setup.action_type, setup.frequency, first_steps=math.inf)

    def reset(self, seed: int) -> None:
        """Begin an episode."""
        self._episode.reset(seed)
        self._seed, self._steps, self._score = seed, 0, 0.0
        self._corrections: Counter[str] = Counter()
        self._digest = hashlib.sha256()
        self.end_reason: str | None = None
        state = self._episode.state()
        self._safety.begin({spec.Obs.STATE: state})
        self._note(state)

    def observe(self) -> ObservationDict:
        """Return the present observation; a new one each time, which the caller may change."""
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
            ActionError: the step is not one of embodiment and action type. Nothing has moved then.
        """
        if not isinstance(action, Mapping):
            raise ActionError(f"an action step must be a map of arrays, got {type(action).__name__}")
        if self.end_reason is not None:
            self._safety.read(action)
            return self._report({})
        verdict = self._safety.check(action)
        if verdict.held == NON_FINITE:
            # No simulator sees the value: a NaN in a command spreads through a whole state.
            self.end_reason = NON_FINITE
            return self._report({})
        corrections = _by_arm(verdict)
        step = {key: np.asarray(value, dtype=_FLOAT32) for key, value in verdict.action.items()}
        for prefix, found in (self._episode.step(step) or {}).items():
            corrections.setdefault(prefix, {}).update(found)
        self._steps += 1
        state = self._episode.state()
        self._note(state)
        self._judge(state)
        if corrections:
            self._corrections.update(kind for kinds in corrections.values() for kind in kinds)
        return self._report(corrections)

    def vision(self) -> dict[str, Mapping[str, Any]]:
        """Return what each camera sees now, whether or not observations show it."""
        return dict(self._episode.vision())

    def simulated(self) -> Simulated | None:
        """Return what the simulator says for itself; None if it does not."""
        return self._episode.simulated()

    def result(self) -> Result:
        """Return the episode's outcome so far: plain values, ready for a report."""
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
        """Release what the simulator holds."""
        self._episode.close()

    def _note(self, state: State) -> None:
        """Add the present state to the digest, and the truth about it."""
        self._digest.update(b"".join((*_digested(state), *_digested(self._episode.truth()))))

    def _judge(self, state: State) -> None:
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


def _by_arm(verdict: Verdict) -> Corrections:
    result: Corrections = {}
    for found in verdict.corrections:
        kinds = result.setdefault(found.prefix, {})
        kinds[found.kind] = max(found.amount, kinds.get(found.kind, 0.0))
    return result


def _is_finite(state: State) -> bool:
    # A robot has few numbers: one by one they cost less than what numpy does before the first.
    for value in state.values():  # noqa: SIM110 - a generator costs as much as the rest
        if not all(map(math.isfinite, np.asarray(value).ravel().tolist())):
            return False
    return True


def _digested(value: object) -> list[bytes]:
    """Return a value as a digest takes it: maps by sorted keys, numbers and arrays as float64, others part by part."""
    if isinstance(value, Mapping):
        found: list[bytes] = []
        for key in sorted(value):
            part = value[key]
            found.append(_word(key))
            if type(part) is np.ndarray and part.dtype is _FLOAT64:  # what most are
                found += (_word(part.shape), part.tobytes())
            else:
                found += _digested(part)
        return found
    array = np.asarray(value)
    if array.dtype.kind in "biuf":
        return [_word(array.shape), array.astype(np.float64).tobytes()]
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        return [each for part in value for each in _digested(part)]
    return [f"{value}\0".encode()]


@functools.lru_cache(maxsize=1024, typed=True)
def _word(value: Hashable) -> bytes:
    """Return a key or a shape as a digest takes it; the same few come in every control step."""
    return f"{value}\0".encode()
