"""A guard in front of a task environment: what its robot is told passes a supervisor (`xpl.safety`) first.

    env = GuardedEnv(robot_env, lambda: Supervisor(embodiment, "joint", 25))
    loop(env, env.listen(client))

It has the surface of a task environment itself, so that any evaluation loop runs on it.
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
    from xpl.safety import Supervisor, Verdict

_ASKS = (spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH, spec.Method.INFER)


@dataclass
class _Watched:
    """One environment's episode, as the guard knows it.

    Attributes:
        supervisor: judges its actions.
        seen: when its latest observation was made.
        answered: when the observation was made that present actions answer, and how many of them came since; None
            where nobody told that the policy was asked.
        end_reason: why the guard ended it.
        steps: actions that were executed or held.
        log: what had to be corrected, by kind.
    """

    supervisor: Supervisor
    seen: float
    answered: tuple[float, int] | None = None
    end_reason: str | None = None
    steps: int = 0
    log: dict[str, dict[str, Any]] = field(default_factory=dict)

    def age(self, now: float) -> float:
        """Return the age of the next action, s: each step of a chunk is meant for one period later."""
        if self.answered is None:
            return now - self.seen
        at, executed = self.answered
        return now - at - executed * self.supervisor.period

    def note(self, verdict: Verdict) -> None:
        """Count a step and what was corrected in it."""
        self.steps += 1
        if self.answered is not None:
            self.answered = self.answered[0], self.answered[1] + 1
        if verdict.ends:
            self.end_reason = verdict.held
        for found in verdict.corrections:
            entry = self.log.setdefault(found.kind, {"count": 0, "amount": 0.0})
            entry["count"] += 1
            if found.amount > entry["amount"]:
                entry.update(amount=found.amount, where=found.where, step=self.steps)


class GuardedEnv:
    """A task environment whose actions pass a supervisor.

    An action that is too old is not executed: the pose is held. A value that is not finite, and a first action far from
    the pose, hold the pose and end the episode with that reason; the environment leaves the running list. Whatever else
    breaks a limit is corrected and executed.

    Args:
        task_env: environment, or several, with the surface that benchmarks call TASK_ENV.
        make_supervisor: returns a new supervisor; each environment gets one.
        clock: tells seconds; give a simulation's own where that is what its robot lives by.
    """

    guarded = True

    def __init__(
        self, task_env: TaskEnv, make_supervisor: Callable[[], Supervisor], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._env = task_env
        self._make_supervisor = make_supervisor
        self._clock = clock
        self._watched: dict[int, _Watched] = {}

    def __getattr__(self, name: str) -> Any:
        """Return what the environment offers besides the surface."""
        return getattr(self._env, name)

    def listen(self, client: Any) -> Any:
        """Return the client, listened to: a chunk is as old as the observation that the policy had when it was asked.

        With a client that nobody listens to, an action's age is that of the latest observation.
        """
        return _Listener(client, self._asked)

    def reset(self, seed: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start a new episode in every environment."""
        self._watched = {}
        self._env.reset(seed, options)

    def get_obs(self) -> ObservationDict:
        """Return the observation of the only environment."""
        now = self._clock()
        obs: ObservationDict = self._env.get_obs()
        self._saw(0, obs, now)
        return obs

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks may pass it by position
    ) -> list[ObservationDict]:
        """Return the observations of some environments, of all running ones by default."""
        chosen = self.get_running_env_idx_list() if env_idx_list is None else list(env_idx_list)
        if last_frame:
            shown: list[ObservationDict] = self._env.get_obs_batch(chosen, last_frame)
            return shown
        now = self._clock()
        observations: list[ObservationDict] = self._env.get_obs_batch(chosen)
        for index, obs in zip(chosen, observations):
            self._saw(index, obs, now)
        return observations

    def take_action(self, action: Action) -> Report:
        """Execute one action step in the only environment, as far as it is safe; return its report."""
        return self.take_action_batch([action], [0])[0]

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[Report]:
        """Execute one action step in each of some environments, as far as it is safe.

        Returns:
            the environment's report of each, where it gives one, with `env_idx`, `end_reason`, `corrections` (by arm
            prefix, of each kind the amount) and `held`: why the pose was held instead, or None.

        Raises:
            ActionError: an action has the wrong keys or dimensions. Nothing has moved then.
            ValueError: the lists differ in length, or an index is repeated.
        """
        if len(actions) != len(env_idx_list) or len(set(env_idx_list)) != len(env_idx_list):
            raise ValueError(f"expected one action for each environment once, got {len(actions)} for {env_idx_list}")
        unseen = [index for index in env_idx_list if index not in self._watched]
        if unseen:
            self.get_obs_batch(unseen)
        for index, action in zip(env_idx_list, actions):
            self._watched[index].supervisor.read(action)
        verdicts: dict[int, Verdict] = {}
        for index, action in zip(env_idx_list, actions):
            watched = self._watched[index]
            if watched.end_reason is None:
                verdicts[index] = watched.supervisor.check(action, watched.age(self._clock()))
                watched.note(verdicts[index])
        told = self._env.take_action_batch([verdict.action for verdict in verdicts.values()], list(verdicts))
        reports = dict(zip(verdicts, told or ()))
        return [self._report(index, reports.get(index), verdicts.get(index)) for index in env_idx_list]

    def is_episode_end(self) -> bool:
        """Return whether the episodes of all environments have ended."""
        return not self.get_running_env_idx_list()

    def get_running_env_idx_list(self) -> list[int]:
        """Return the environments whose episode goes on."""
        return [index for index in self._env.get_running_env_idx_list() if self._ended(index) is None]

    def results(self) -> list[Result]:
        """Return the environment's results, with the guard's reason of an end and its `safety` record.

        `corrections` counts those of both. `safety` holds, for each kind of the guard's, its `count` and the largest
        `amount`, with `where` and in which `step` that was.
        """
        results = []
        for place, given in enumerate(self._env.results()):
            result = dict(given)
            watched = self._watched.get(result.get(spec.Obs.ENV_IDX, place))
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

    def _saw(self, index: int, obs: Observation, now: float) -> None:
        watched = self._watched.get(index)
        if watched is not None:
            watched.seen = now
            return
        supervisor = self._make_supervisor()
        supervisor.begin(obs)
        self._watched[index] = _Watched(supervisor, now)

    def _asked(self) -> None:
        for watched in self._watched.values():
            watched.answered = watched.seen, 0

    def _ended(self, index: int) -> str | None:
        watched = self._watched.get(index)
        return None if watched is None else watched.end_reason

    def _report(self, index: int, given: object, verdict: Verdict | None) -> Report:
        report = dict(given) if isinstance(given, Mapping) else {}
        corrections = {prefix: dict(found) for prefix, found in (report.get("corrections") or {}).items()}
        for found in () if verdict is None else verdict.corrections:
            corrections.setdefault(found.prefix, {})[found.kind] = found.amount
        return {
            **report,
            spec.Obs.ENV_IDX: index,
            "end_reason": self._ended(index) or report.get("end_reason"),
            "corrections": corrections,
            "held": None if verdict is None else verdict.held,
        }


class _Listener:
    """A client that tells when the policy is asked for actions; everything else passes."""

    def __init__(self, client: Any, asked: Callable[[], None]) -> None:
        self._client = client
        self._asked = asked

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._client, name)
        if name not in _ASKS:
            return found

        def ask(*args: Any, **kwargs: Any) -> Any:
            self._asked()
            return found(*args, **kwargs)

        return ask

    def call(self, func_name: str, *args: Any, **kwargs: Any) -> Any:
        """Call an operation by name."""
        if func_name in _ASKS:
            self._asked()
        return self._client.call(func_name, *args, **kwargs)
