"""A guard in front of an environment: every action passes a supervisor (`xpl.safety`) first.

    env = GuardedEnv(robot_env, lambda: Supervisor(embodiment, "joint", 25))
    loop(env, env.listen(client))

It has the interface of an environment, so any evaluation loop runs on it.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Callable

from xpl import _spec as spec

if TYPE_CHECKING:
    from xpl.contract import Action, Observation, ObservationDict, Report, Result
    from xpl.environment import TaskEnv
    from xpl.safety import SafetyVerdict, Supervisor

_INFERENCE = (spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH, spec.Method.INFER)


@dataclass
class _GuardedEpisode:
    """State of one environment's episode.

    Attributes:
        supervisor: checks its actions.
        observed_at: time of its latest observation, s.
        chunk_origin: (time of the observation of the current chunk, number of its actions so far); None if the guard
            does not observe the client.
        end_reason: reason for which the guard ended it.
        steps: number of actions that were executed or replaced by a hold.
        log: corrections by kind.
    """

    supervisor: Supervisor
    observed_at: float
    chunk_origin: tuple[float, int] | None = None
    end_reason: str | None = None
    steps: int = 0
    log: dict[str, dict[str, Any]] = field(default_factory=dict)

    def age(self, now: float) -> float:
        """Return the age of the next action, s; each step of a chunk is meant for one period later."""
        if self.chunk_origin is None:
            return now - self.observed_at
        at, executed = self.chunk_origin
        return now - at - executed * self.supervisor.period

    def count(self, verdict: SafetyVerdict) -> None:
        """Count a step and its corrections."""
        self.steps += 1
        if self.chunk_origin is not None:
            self.chunk_origin = self.chunk_origin[0], self.chunk_origin[1] + 1
        if verdict.ends:
            self.end_reason = verdict.hold_reason
        for found in verdict.corrections:
            entry = self.log.setdefault(found.kind, {"count": 0, "amount": 0.0})
            entry["count"] += 1
            if found.amount > entry["amount"]:
                entry.update(amount=found.amount, where=found.where, step=self.steps)


class GuardedEnv:
    """An environment whose actions pass a supervisor.

    An action that is too old is not executed: the robot holds its pose. A value that is not finite, and a first action
    far from the pose, hold the pose and end the episode with that reason. Any other violation of a limit is corrected,
    and the action executed.

    Args:
        task_env: one or several environments, with the interface that benchmarks call TASK_ENV.
        make_supervisor: returns a new supervisor, for each environment.
        clock: returns seconds; a simulation may pass its own.
    """

    guarded = True

    def __init__(
        self, task_env: TaskEnv, make_supervisor: Callable[[], Supervisor], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._env = task_env
        self._make_supervisor = make_supervisor
        self._clock = clock
        self._episodes: dict[int, _GuardedEpisode] = {}

    def __getattr__(self, name: str) -> Any:
        """Return another attribute of the environment."""
        return getattr(self._env, name)

    def listen(self, client: Any) -> Any:
        """Return a client that reports inferences to the guard: a chunk is as old as the observation of its inference.

        With an unobserved client, an action's age is that of the latest observation.
        """
        return _CallObserver(client, self._on_inference)

    def reset(self, seed: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start a new episode in every environment."""
        self._episodes = {}
        self._env.reset(seed, options)

    def get_obs(self) -> ObservationDict:
        """Return the observation of the only environment."""
        now = self._clock()
        obs: ObservationDict = self._env.get_obs()
        self._record_observation(0, obs, now)
        return obs

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks may pass it by position
    ) -> list[ObservationDict]:
        """Return the observations of some environments, of all running ones by default."""
        chosen = self.get_running_env_idx_list() if env_idx_list is None else list(env_idx_list)
        if last_frame:
            last: list[ObservationDict] = self._env.get_obs_batch(chosen, last_frame)
            return last
        now = self._clock()
        observations: list[ObservationDict] = self._env.get_obs_batch(chosen)
        for index, obs in zip(chosen, observations):
            self._record_observation(index, obs, now)
        return observations

    def take_action(self, action: Action) -> Report:
        """Execute one action in the only environment, as far as it is safe; return its report."""
        return self.take_action_batch([action], [0])[0]

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[Report]:
        """Execute one action in each environment of the list, as far as it is safe.

        Returns:
            The environment's reports, with `env_idx`, `end_reason`, `corrections` (amount by arm prefix and kind) and
            `hold_reason`: why the pose was held instead, or None.

        Raises:
            ActionError: an action has the wrong keys or dimensions. Nothing was executed.
            ValueError: the lists differ in length, or an index is repeated.
        """
        if len(actions) != len(env_idx_list) or len(set(env_idx_list)) != len(env_idx_list):
            raise ValueError(f"expected one action for each environment once, got {len(actions)} for {env_idx_list}")
        unseen = [index for index in env_idx_list if index not in self._episodes]
        if unseen:
            self.get_obs_batch(unseen)
        for index, action in zip(env_idx_list, actions):
            self._episodes[index].supervisor.read(action)
        verdicts: dict[int, SafetyVerdict] = {}
        for index, action in zip(env_idx_list, actions):
            watched = self._episodes[index]
            if watched.end_reason is None:
                verdicts[index] = watched.supervisor.check(action, watched.age(self._clock()))
                watched.count(verdicts[index])
        executed = self._env.take_action_batch([verdict.action for verdict in verdicts.values()], list(verdicts))
        reports = dict(zip(verdicts, executed or ()))
        return [self._report(index, reports.get(index), verdicts.get(index)) for index in env_idx_list]

    def is_episode_end(self) -> bool:
        """Return whether the episodes of all environments have ended."""
        return not self.get_running_env_idx_list()

    def get_running_env_idx_list(self) -> list[int]:
        """Return the environments whose episode goes on."""
        return [index for index in self._env.get_running_env_idx_list() if self._end_reason(index) is None]

    def results(self) -> list[Result]:
        """Return the environment's results, with the guard's end reason and its `safety` record.

        `corrections` counts those of both. `safety` has, by kind of the guard's corrections, `count` and the largest
        `amount`, with `where` and `step`.
        """
        results = []
        for index, raw in enumerate(self._env.results()):
            result = dict(raw)
            watched = self._episodes.get(result.get(spec.Obs.ENV_IDX, index))
            if watched is not None:
                counts = Counter({kind: entry["count"] for kind, entry in watched.log.items()})
                result["corrections"] = dict(counts + Counter(result.get("corrections") or {}))
                result["safety"] = {kind: dict(entry) for kind, entry in watched.log.items()}
                result["end_reason"] = watched.end_reason or result.get("end_reason")
            results.append(result)
        return results

    def close(self) -> None:
        """Close the environment."""
        self._env.close()

    def _record_observation(self, index: int, obs: Observation, now: float) -> None:
        watched = self._episodes.get(index)
        if watched is not None:
            watched.observed_at = now
            return
        supervisor = self._make_supervisor()
        supervisor.begin(obs)
        self._episodes[index] = _GuardedEpisode(supervisor, now)

    def _on_inference(self) -> None:
        for watched in self._episodes.values():
            watched.chunk_origin = watched.observed_at, 0

    def _end_reason(self, index: int) -> str | None:
        watched = self._episodes.get(index)
        return None if watched is None else watched.end_reason

    def _report(self, index: int, env_report: object, verdict: SafetyVerdict | None) -> Report:
        report = dict(env_report) if isinstance(env_report, Mapping) else {}
        corrections = {prefix: dict(found) for prefix, found in (report.get("corrections") or {}).items()}
        for found in () if verdict is None else verdict.corrections:
            corrections.setdefault(found.prefix, {})[found.kind] = found.amount
        return {
            **report,
            spec.Obs.ENV_IDX: index,
            "end_reason": self._end_reason(index) or report.get("end_reason"),
            "corrections": corrections,
            "hold_reason": None if verdict is None else verdict.hold_reason,
        }


class _CallObserver:
    """A client that reports calls for actions; everything else is passed on."""

    def __init__(self, client: Any, on_inference: Callable[[], None]) -> None:
        self._client = client
        self._on_inference = on_inference

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._client, name)
        if name not in _INFERENCE:
            return found

        def ask(*args: Any, **kwargs: Any) -> Any:
            self._on_inference()
            return found(*args, **kwargs)

        return ask

    def call(self, func_name: str, *args: Any, **kwargs: Any) -> Any:
        """Call an operation by name."""
        if func_name in _INFERENCE:
            self._on_inference()
        return self._client.call(func_name, *args, **kwargs)
