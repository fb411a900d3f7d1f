"""One rollout in physics: an adapter and an environment, step by step, and the record of it."""

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


class LoopEnv(Protocol):
    """The operations of an environment that a rollout needs (`xpl.environment.TaskEnv`)."""

    def get_running_env_idx_list(self) -> list[int]:
        """Return the indices of environments whose episode is running."""

    def get_obs_batch(self, env_idx_list: Sequence[int]) -> list[ObservationDict]:
        """Return observations of some environments."""

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[contract.Report]:
        """Execute one action step in some environments, and return a report of each."""

    def results(self) -> list[contract.Result]:
        """Return the outcome of every environment's episode."""


StepCallback = Callable[[LoopEnv], None]
"""Gets the environment before every control step, and once more at the end."""


@dataclass(frozen=True)
class PhysicsEpisodeResult:
    """An environment's result of an episode.

    Attributes:
        success: whether it succeeded.
        score: its score, 0..1.
        end_reason: why it ended; None if it did not end.
        corrections: number of corrected commands, by kind.
        digest: of the trajectory.
    """

    success: bool
    score: float
    end_reason: str | None
    corrections: Mapping[str, int]
    digest: str

    @classmethod
    def read(cls, result: contract.Result) -> Self:
        """Read one of `results` of an environment of the SDK."""
        reason = result["end_reason"]
        return cls(
            bool(result["success"]), float(result["score"]), reason, dict(result["corrections"]), str(result["digest"])
        )


@dataclass(frozen=True)
class RecordedObservations:
    """The observations of a rollout.

    Attributes:
        observations: one for every control step.
        inference_steps: control steps of the inferences.
    """

    observations: tuple[ObservationDict, ...]
    inference_steps: tuple[int, ...]


@dataclass(frozen=True)
class PhysicsInference:
    """One inference of a rollout.

    Attributes:
        step: its control step in the environment.
        state: the `state` of the observation.
        chunk: flat actions (H, D).
        seconds: time of `get_action` and of every `update_obs` since the previous inference, s.
    """

    step: int
    state: contract.State
    chunk: np.ndarray
    seconds: float


@dataclass
class PhysicsRollout:
    """The record of one rollout.

    Attributes:
        setup: task, robot and setting.
        robot: the embodiment.
        seeds: one per environment.
        results: the environment's result of each episode.
        inferences: per environment, every inference.
        commands: per environment, the flat action of every step, (D,) each.
        corrections: per environment, for every step the kinds of corrections.
        problem: why the rollout ended early, or None.
    """

    setup: RolloutSetup
    robot: Embodiment
    seeds: tuple[int, ...]
    results: list[PhysicsEpisodeResult] = field(default_factory=list)
    inferences: list[list[PhysicsInference]] = field(default_factory=list)
    commands: list[list[np.ndarray]] = field(default_factory=list)
    corrections: list[list[frozenset[str]]] = field(default_factory=list)
    problem: str | None = None

    def __post_init__(self) -> None:
        """Add an empty list for each environment."""
        for lists in (self.inferences, self.commands, self.corrections):
            lists.extend([] for _ in self.seeds)

    @property
    def steps(self) -> int:
        """Control steps of all environments together."""
        return sum(len(commands) for commands in self.commands)

    @property
    def digests(self) -> list[str]:
        """The digest of each environment's trajectory."""
        return [result.digest for result in self.results]

    def count_corrected(self, kinds: frozenset[str]) -> int:
        """Return the number of steps with a correction of one of these kinds."""
        return sum(bool(kinds & found) for steps in self.corrections for found in steps)


@dataclass(frozen=True)
class RolloutRunner:
    """Runs a policy in an environment: each chunk to its end, with `update_obs` at every control step.

    Attributes:
        session: the policy.
        env: the environment, reset.
        rollout: the record.
        only: index of the one environment of the batch that moves; the others stand still.
        on_step: gets the environment before every control step.
        recorded: gets every observation that is sent to the policy, if given.
        executed_from: an earlier rollout, whose actions are executed instead of the current ones.
        copied: send the observation of the one environment for all others, too, as long as they ran in `executed_from`.
    """

    session: RecordedClient
    env: LoopEnv
    rollout: PhysicsRollout
    only: int | None = None
    on_step: StepCallback | None = None
    recorded: list[ObservationDict] | None = None
    executed_from: PhysicsRollout | None = None
    copied: bool = False

    def run(self) -> None:
        """Run the episodes to their end, or until an error."""
        rollout = self.rollout
        try:
            rollout.problem = self._run_until_end()
        except ClientError as error:
            rollout.problem = str(error)
        rollout.results = [PhysicsEpisodeResult.read(told) for told in self.env.results()]
        if rollout.problem is None:
            ends = {result.end_reason for place, result in enumerate(rollout.results) if self.only in (None, place)}
            wrong = sorted(map(str, ends.difference(_SOUND_ENDS)))
            rollout.problem = f"the episode ended with {', '.join(wrong)}" if wrong else None

    def _run_until_end(self) -> str | None:
        begun = self.session.reset()
        if isinstance(begun, PolicyServerError):
            return str(begun)
        while running := self._running():
            problem = self._run_chunk(running)
            if problem is not None:
                return problem
        if self.on_step is not None:
            self.on_step(self.env)
        return None

    def _running(self) -> list[int]:
        """Return the indices of environments that move and are still running."""
        return [env for env in self.env.get_running_env_idx_list() if self.only in (None, env)]

    def _run_chunk(self, running: list[int]) -> str | None:
        """Run one inference and execute the whole chunk; return the problem, or None."""
        observations = self._observe(running)
        sent = self._with_copies(observations)
        indices = [obs[sdk.Obs.ENV_IDX] for obs in sent]
        seconds = time.perf_counter()
        update_reply = self.session.update_obs_batch(sent)
        chunks = self.session.get_action_batch(indices)
        seconds = time.perf_counter() - seconds
        problem = self._reply_problem(update_reply, chunks, len(indices))
        if problem is not None:
            return problem
        answers = dict(zip(indices, chunks, strict=True))
        for env, obs in zip(running, observations, strict=True):
            flat = np.stack([self._pack_action(action) for action in answers[env]])
            step = len(self.rollout.commands[env])
            self.rollout.inferences[env].append(PhysicsInference(step, obs[sdk.Obs.STATE], flat, seconds))
        return self._execute(
            {
                env: answers[env] if self.executed_from is None else self._earlier_chunk(self.executed_from, env)
                for env in running
            }
        )

    def _earlier_chunk(self, earlier: PhysicsRollout, env: int) -> list[contract.ActionStep]:
        """Return the chunk of an earlier rollout for the latest inference."""
        chunk = earlier.inferences[env][len(self.rollout.inferences[env]) - 1].chunk
        return [unpack(action, self.rollout.robot, self.rollout.setup.action_type) for action in chunk]

    def _observe(self, running: Sequence[int]) -> list[ObservationDict]:
        observations = self.env.get_obs_batch(running)
        if self.recorded is not None:
            self.recorded.extend(observations)
        return observations

    def _with_copies(self, observations: list[ObservationDict]) -> list[ObservationDict]:
        """Return the observations to send, with copies of the one environment's if `copied`."""
        if not self.copied or self.executed_from is None:
            return observations
        (own,) = observations
        now = len(self.rollout.commands[own[sdk.Obs.ENV_IDX]])
        there = [len(commands) > now for commands in self.executed_from.commands]
        return [{**own, sdk.Obs.ENV_IDX: env} for env, runs in enumerate(there) if runs or env == own[sdk.Obs.ENV_IDX]]

    def _reply_problem(self, refused: Answer, chunks: Answer, count: int) -> str | None:
        for answer in (refused, chunks):
            if isinstance(answer, PolicyServerError):
                return str(answer)
        if not isinstance(chunks, (list, tuple)) or len(chunks) != count:
            return f"{count} environments were requested, but the policy did not return as many chunks"
        problems = (structure_problem(chunk, self.rollout.robot, self.rollout.setup.action_type) for chunk in chunks)
        return next((problem for problem in problems if problem is not None), None)

    def _execute(self, by_env: Mapping[int, Sequence[Action]]) -> str | None:
        for index in range(max(map(len, by_env.values()))):
            alive = self.env.get_running_env_idx_list()
            moved = [env for env, chunk in by_env.items() if env in alive and index < len(chunk)]
            if not moved:
                break
            if index:
                refused = self._send_observations(moved)
                if refused is not None:
                    return refused
            problem = self._step({env: by_env[env][index] for env in moved})
            if problem is not None:
                return problem
        return None

    def _send_observations(self, moved: Sequence[int]) -> str | None:
        """Send the observations between the steps of a chunk, as an evaluation loop does."""
        observations = self._with_copies(self._observe(moved))
        started = time.perf_counter()
        refused = self.session.update_obs_batch(observations)
        waited = time.perf_counter() - started
        for env in moved:
            last = self.rollout.inferences[env][-1]
            self.rollout.inferences[env][-1] = PhysicsInference(
                last.step, last.state, last.chunk, last.seconds + waited
            )
        return str(refused) if isinstance(refused, PolicyServerError) else None

    def _step(self, actions: Mapping[int, Action]) -> str | None:
        if self.on_step is not None:
            self.on_step(self.env)
        try:
            reports = self.env.take_action_batch(list(actions.values()), list(actions))
        except ActionError as error:
            return str(error)
        for (env, action), report in zip(actions.items(), reports, strict=True):
            self.rollout.commands[env].append(self._pack_action(action))
            kinds = frozenset(kind for arm in report["corrections"].values() for kind in arm)
            self.rollout.corrections[env].append(kinds)
        return None

    def _pack_action(self, action: Action) -> np.ndarray:
        flat: np.ndarray = pack(action, self.rollout.robot, self.rollout.setup.action_type)
        return flat


def largest_changes(rollout: PhysicsRollout) -> Iterator[tuple[float, float]]:
    """Yield the largest changes of commands for each environment whose chunks have several steps.

    Grippers are excluded. Both changes are in rad for joints and in m for positions.

    Yields:
        the largest change from the end of a chunk to the beginning of the next, and that inside chunks.
    """
    columns = _arm_columns(rollout.robot, rollout.setup.action_type)
    for commands, queries in zip(rollout.commands, rollout.inferences, strict=True):
        changes = np.abs(np.diff(np.stack(commands)[:, columns], axis=0)).max(axis=1) if commands else np.zeros(0)
        boundaries = np.zeros(len(changes), dtype=bool)
        boundaries[[query.step - 1 for query in queries if 0 < query.step <= len(changes)]] = True
        if boundaries.any() and not boundaries.all():
            yield float(changes[boundaries].max()), float(changes[~boundaries].max())


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
