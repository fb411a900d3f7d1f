"""One closed loop in physics: an adapter and an environment, step by step, and what is noted of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np

from xpl import _spec as sdk
from xpl.action import ActionError, pack, unpack
from xpl.client import ClientError, PolicyServerError
from xpl_cli.audit.served.compare import structure_problem

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl import contract
    from xpl.contract import Action, ObservationDict
    from xpl.embodiment import Embodiment
    from xpl_cli.audit.rules.measurements import RolloutSetup
    from xpl_cli.audit.served.recorded_client import Answer, RecordedClient

_SOUND_ENDS = ("success", "max_steps")


class Playing(Protocol):
    """What a loop needs of an environment (`xpl.environment.TaskEnv`)."""

    def get_running_env_idx_list(self) -> list[int]:
        """Return the environments whose episode goes on."""

    def get_obs_batch(self, env_idx_list: Sequence[int]) -> list[ObservationDict]:
        """Return observations of some environments."""

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[contract.Report]:
        """Execute one action step in some environments, and return a report of each."""

    def results(self) -> list[contract.Result]:
        """Return the outcome of every environment's episode."""


Watch = Callable[[Playing], None]
"""Is shown the environment before every control step, and once more at the end."""


@dataclass(frozen=True)
class Result:
    """What an environment says of an episode.

    Attributes:
        success: whether it came to its goal.
        score: how far it came, 0..1.
        end_reason: why it ended; None if it did not.
        corrections: how often commands had to be corrected, by kind.
        digest: of the trajectory.
    """

    success: bool
    score: float
    end_reason: str | None
    corrections: Mapping[str, int]
    digest: str

    @classmethod
    def read(cls, told: contract.Result) -> Self:
        """Read one of `results` of an environment of the SDK."""
        reason = told["end_reason"]
        return cls(bool(told["success"]), float(told["score"]), reason, dict(told["corrections"]), str(told["digest"]))


@dataclass(frozen=True)
class Show:
    """What is shown in a loop.

    Attributes:
        observations: of every control step.
        asked: steps at which an answer is asked for.
    """

    observations: tuple[ObservationDict, ...]
    asked: tuple[int, ...]


@dataclass(frozen=True)
class Query:
    """A question in a loop, with its answer.

    Attributes:
        step: control step of the environment at which it was asked.
        state: the `state` map that the policy was shown then.
        chunk: flat actions (H, D) of the answer.
        waited: time for the answer and for what was shown since the question before, s.
    """

    step: int
    state: contract.State
    chunk: np.ndarray
    waited: float


@dataclass
class Rollout:
    """What happened in one closed loop.

    Attributes:
        course: what was driven.
        robot: the embodiment.
        seeds: one per environment.
        results: what the environment says of each episode.
        queries: per environment, every question with its answer.
        commands: per environment, the flat action of every step, (D,) each.
        corrections: per environment, for every step the kinds of corrections that were necessary.
        problem: why the loop ended early, or None.
    """

    course: RolloutSetup
    robot: Embodiment
    seeds: tuple[int, ...]
    results: list[Result] = field(default_factory=list)
    queries: list[list[Query]] = field(default_factory=list)
    commands: list[list[np.ndarray]] = field(default_factory=list)
    corrections: list[list[frozenset[str]]] = field(default_factory=list)
    problem: str | None = None

    def __post_init__(self) -> None:
        """Make room for each environment."""
        for kept in (self.queries, self.commands, self.corrections):
            kept.extend([] for _ in self.seeds)

    @property
    def steps(self) -> int:
        """Control steps of all environments together."""
        return sum(len(commands) for commands in self.commands)

    @property
    def digests(self) -> list[str]:
        """The digest of each environment's trajectory."""
        return [result.digest for result in self.results]

    def corrected(self, kinds: frozenset[str]) -> int:
        """Return in how many steps a correction of one of these kinds was necessary."""
        return sum(bool(kinds & found) for steps in self.corrections for found in steps)


@dataclass(frozen=True)
class Driver:
    """Drives an environment by what a policy answers: each chunk to its end, every observation shown.

    Attributes:
        session: the policy.
        env: the environment, reset.
        played: where everything is noted.
        only: place of the one environment of the batch that is driven; the others stand still.
        watch: is shown the environment before every control step.
        shown: takes every observation that the policy is shown, where they are wanted.
        follows: an earlier loop, whose answers are executed instead of those that are given now.
        copied: show what the one environment shows in place of all others, too, as long as they ran in `follows`.
    """

    session: RecordedClient
    env: Playing
    played: Rollout
    only: int | None = None
    watch: Watch | None = None
    shown: list[ObservationDict] | None = None
    follows: Rollout | None = None
    copied: bool = False

    def drive(self) -> None:
        """Play the episodes to their end, or until something breaks."""
        played = self.played
        try:
            played.problem = self._to_the_end()
        except ClientError as error:
            played.problem = str(error)
        played.results = [Result.read(told) for told in self.env.results()]
        if played.problem is None:
            ends = {result.end_reason for place, result in enumerate(played.results) if self.only in (None, place)}
            wrong = sorted(map(str, ends.difference(_SOUND_ENDS)))
            played.problem = f"the episode ended with {', '.join(wrong)}" if wrong else None

    def _to_the_end(self) -> str | None:
        begun = self.session.reset()
        if isinstance(begun, PolicyServerError):
            return str(begun)
        while running := self._running():
            problem = self._chunk(running)
            if problem is not None:
                return problem
        if self.watch is not None:
            self.watch(self.env)
        return None

    def _running(self) -> list[int]:
        """Return the environments that are driven and still run."""
        return [env for env in self.env.get_running_env_idx_list() if self.only in (None, env)]

    def _chunk(self, running: list[int]) -> str | None:
        """Ask once and execute the whole chunk; return what went wrong, or None."""
        observations = self._seen(running)
        shown = self._with_copies(observations)
        asked = [obs[sdk.Obs.ENV_IDX] for obs in shown]
        waited = time.perf_counter()
        refused = self.session.update_obs_batch(shown)
        chunks = self.session.get_action_batch(asked)
        waited = time.perf_counter() - waited
        problem = self._problem(refused, chunks, len(asked))
        if problem is not None:
            return problem
        answers = dict(zip(asked, chunks, strict=True))
        for env, obs in zip(running, observations, strict=True):
            flat = np.stack([self._packed(action) for action in answers[env]])
            step = len(self.played.commands[env])
            self.played.queries[env].append(Query(step, obs[sdk.Obs.STATE], flat, waited))
        return self._execute(
            {env: answers[env] if self.follows is None else self._then(self.follows, env) for env in running}
        )

    def _then(self, earlier: Rollout, env: int) -> list[contract.ActionStep]:
        """Return the chunk with which an earlier loop answered the question that was asked last."""
        chunk = earlier.queries[env][len(self.played.queries[env]) - 1].chunk
        return [unpack(action, self.played.robot, self.played.course.action_type) for action in chunk]

    def _seen(self, running: Sequence[int]) -> list[ObservationDict]:
        observations = self.env.get_obs_batch(running)
        if self.shown is not None:
            self.shown.extend(observations)
        return observations

    def _with_copies(self, observations: list[ObservationDict]) -> list[ObservationDict]:
        """Return what the policy is shown: in a copy's place stands what the one environment shows."""
        if not self.copied or self.follows is None:
            return observations
        (own,) = observations
        now = len(self.played.commands[own[sdk.Obs.ENV_IDX]])
        there = [len(commands) > now for commands in self.follows.commands]
        return [{**own, sdk.Obs.ENV_IDX: env} for env, runs in enumerate(there) if runs or env == own[sdk.Obs.ENV_IDX]]

    def _problem(self, refused: Answer, chunks: Answer, count: int) -> str | None:
        for answer in (refused, chunks):
            if isinstance(answer, PolicyServerError):
                return str(answer)
        if not isinstance(chunks, (list, tuple)) or len(chunks) != count:
            return f"{count} environments were asked for, and not as many chunks came"
        found = (structure_problem(chunk, self.played.robot, self.played.course.action_type) for chunk in chunks)
        return next((problem for problem in found if problem is not None), None)

    def _execute(self, by_env: Mapping[int, Sequence[Action]]) -> str | None:
        for index in range(max(map(len, by_env.values()))):
            alive = self.env.get_running_env_idx_list()
            moved = [env for env, chunk in by_env.items() if env in alive and index < len(chunk)]
            if not moved:
                break
            if index:
                refused = self._show(moved)
                if refused is not None:
                    return refused
            problem = self._step({env: by_env[env][index] for env in moved})
            if problem is not None:
                return problem
        return None

    def _show(self, moved: Sequence[int]) -> str | None:
        """Show what is to be seen between the steps of a chunk, as an evaluation loop does."""
        observations = self._with_copies(self._seen(moved))
        started = time.perf_counter()
        refused = self.session.update_obs_batch(observations)
        waited = time.perf_counter() - started
        for env in moved:
            last = self.played.queries[env][-1]
            self.played.queries[env][-1] = Query(last.step, last.state, last.chunk, last.waited + waited)
        return str(refused) if isinstance(refused, PolicyServerError) else None

    def _step(self, actions: Mapping[int, Action]) -> str | None:
        if self.watch is not None:
            self.watch(self.env)
        try:
            reports = self.env.take_action_batch(list(actions.values()), list(actions))
        except ActionError as error:
            return str(error)
        for (env, action), report in zip(actions.items(), reports, strict=True):
            self.played.commands[env].append(self._packed(action))
            kinds = frozenset(kind for arm in report["corrections"].values() for kind in arm)
            self.played.corrections[env].append(kinds)
        return None

    def _packed(self, action: Action) -> np.ndarray:
        flat: np.ndarray = pack(action, self.played.robot, self.played.course.action_type)
        return flat


def jumps_of_chunks(played: Rollout) -> Iterator[tuple[float, float]]:
    """Yield, for each environment whose chunks have several steps, the largest changes of what must not jump.

    Grippers may jump. Both changes are in rad for joints and in m for positions.

    Yields:
        the largest change from the end of a chunk to the beginning of the next, and that inside chunks.
    """
    columns = _arm_columns(played.robot, played.course.action_type)
    for commands, queries in zip(played.commands, played.queries, strict=True):
        changes = np.abs(np.diff(np.stack(commands)[:, columns], axis=0)).max(axis=1) if commands else np.zeros(0)
        seams = np.zeros(len(changes), dtype=bool)
        seams[[query.step - 1 for query in queries if 0 < query.step <= len(changes)]] = True
        if seams.any() and not seams.all():
            yield float(changes[seams].max()), float(changes[~seams].max())


def _arm_columns(robot: Embodiment, action_type: str) -> np.ndarray:
    """Return the flat action columns of joint angles or positions."""
    columns: list[int] = []
    start = 0
    for key, dim in robot.dims(action_type).items():
        if not key.endswith(sdk.State.EE_JOINT_STATE):
            width = sdk.POSITION_DIM if key.endswith(sdk.State.EE_POSE) else dim
            columns += range(start, start + width)
        start += dim
    return np.array(columns)
