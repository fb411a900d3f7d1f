"""Vectorised environment: environments in worker processes, with the interface that benchmarks call TASK_ENV.

    with contextlib.closing(VectorEnv(folder / "client.py", {**config, "num_envs": 8}, workers=4)) as env:
        env.reset(seeds)

Each worker runs its share of the environments. Results are bit-identical to those of one process; arrays of
observations are read-only. If a worker crashes or hangs, the running episodes of its environments end with an
infrastructure error, and it is restarted at the next reset.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.simulator.process import EnvLostError
from xpl.simulator.worker_pool import EnvTimeouts, EnvWorkerPool

if TYPE_CHECKING:
    from xpl.contract import Action, Config, ObservationDict, Report, Result
    from xpl.simulator.worker_pool import Calls

INFRASTRUCTURE = "infrastructure"
"""`end_reason` of an infrastructure error: a failure that is not the policy's."""

_RUNNING: list[Any] = ["get_running_env_idx_list", []]
_RESULTS: list[Any] = ["results", []]
_FINISH = "finish_episode"
_RENDER = "render"


def shares(total: int, workers: int) -> list[range]:
    """Return the environments of each worker: consecutive indices, in equal shares as far as possible."""
    bounds = [total * worker // workers for worker in range(workers + 1)]
    return [range(first, end) for first, end in zip(bounds, bounds[1:])]


class VectorEnv:
    """Environments of one package, spread over worker processes.

    Args:
        client: the package's client file, which defines `make(config)`.
        config: configuration; `num_envs` (1) is the number of environments of all workers.
        workers: number of processes, at most one per environment.
        python: interpreter of the workers; this one by default.
        limits: time limits after which a worker counts as hung.

    Raises:
        ValueError: the environment refuses the configuration, or there are more workers than environments.
        EnvRaisedError: the environment raised another error.
        EnvLostError: a process ended, or did not answer, while it was made.
    """

    def __init__(
        self,
        client: Path,
        config: Config,
        *,
        workers: int = 1,
        python: str | None = None,
        limits: EnvTimeouts | None = None,
    ) -> None:
        self._total = int(config.get("num_envs") or 1)
        if not 1 <= workers <= self._total:
            raise ValueError(f"expected 1 to {self._total} workers for {self._total} environments, got {workers}")
        self._shares = shares(self._total, workers)
        self._owner = {env: (worker, env - part[0]) for worker, part in enumerate(self._shares) for env in part}
        self._seeds: list[int] = []
        self._options: dict[str, Any] = {}
        self._next_seed = int(config.get(spec.Deploy.SEED) or 0)
        self._running: list[list[int]] = [[] for _ in self._shares]
        self._last: dict[int, ObservationDict] = {}
        self._final: dict[int, Result] = {}
        self._workers = EnvWorkerPool(
            client, [{**config, "num_envs": len(part)} for part in self._shares], python, limits
        )

    @property
    def guarded(self) -> bool:
        """Whether the environment enforces its robot's limits itself."""
        return self._workers.guarded

    @property
    def pids(self) -> list[int]:
        """Process ids of the running workers."""
        return self._workers.pids

    def reset(self, seed: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start a new episode in every environment; lost workers are restarted first.

        Args:
            seed: one seed per environment; None counts on from the seeds used before.
            options: further options of the environment's reset.

        Raises:
            ValueError: wrong number of seeds, or options that the environment refuses.
            EnvRaisedError: the environment raised.
        """
        seeds = range(self._next_seed, self._next_seed + self._total) if seed is None else [int(each) for each in seed]
        if len(seeds) != self._total:
            raise ValueError(f"reset needs {self._total} seeds, one per environment, got {list(seeds)}")
        self._workers.start_missing()
        self._seeds, self._next_seed = list(seeds), seeds[-1] + 1
        self._running = [[] for _ in self._shares]
        self._last, self._final = {}, {}
        # All options of earlier resets, too: a restarted worker has none of them.
        merged_options = {**self._options, **(options or {})}
        more = [merged_options] if merged_options else []
        # With the first observation: an environment that is lost later repeats its last one.
        calls: dict[int, Calls] = {
            worker: [
                [spec.Method.RESET, [self._seeds[part[0] : part[-1] + 1], *more]],
                ["get_obs_batch", [list(range(len(part)))]],
                _RUNNING,
            ]
            for worker, part in enumerate(self._shares)
        }
        for worker, (_, observations, running) in self._workers.reset(calls).items():
            self._store_observations(worker, range(len(observations)), observations)
            self._running[worker] = running
        self._options = merged_options

    def get_obs(self) -> ObservationDict:
        """Return the observation of the only environment.

        Raises:
            ValueError: there are several; use `get_obs_batch`.
        """
        return self.get_obs_batch([self._only_index()])[0]

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks may pass it by position
    ) -> list[ObservationDict]:
        """Return the observations of some environments, in the order of the list; all workers observe in parallel.

        Args:
            env_idx_list: indices; None for all running environments. A lost one repeats its last observation.
            last_frame: return each environment's last observation again.

        Raises:
            EnvLostError: an environment was lost before its first observation.
        """
        chosen = self.get_running_env_idx_list() if env_idx_list is None else list(env_idx_list)
        if not last_frame:
            parts = self._by_worker(chosen)
            calls = {worker: [["get_obs_batch", [local]], _RUNNING] for worker, local in parts.items()}
            answers = self._workers.run(calls)
            for worker, (observations, running) in answers.items():
                self._store_observations(worker, parts[worker], observations)
                self._running[worker] = running
        missing = [index for index in chosen if index not in self._last]
        if missing:
            raise EnvLostError(self._workers.lost[self._owner[missing[0]][0]])
        return [self._last[index] for index in chosen]

    def take_action(self, action: Action) -> Report:
        """Execute one action step in the only environment; return its report."""
        return self.take_action_batch([action], [self._only_index()])[0]

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[Report]:
        """Execute one action in each environment of the list; all workers do so in parallel.

        Returns:
            The environments' reports, with `env_idx`, and `end_reason` if it is lost.

        Raises:
            ActionError: the environment refuses an action; others may have moved.
            ValueError: the lists differ in length, or an index is repeated or unknown.
        """
        if len(actions) != len(env_idx_list) or len(set(env_idx_list)) != len(env_idx_list):
            raise ValueError(f"expected one action for each environment once, got {len(actions)} for {env_idx_list}")
        action_of = dict(zip(env_idx_list, actions))
        parts = self._by_worker(env_idx_list)
        calls = {
            worker: [
                ["take_action_batch", [[action_of[self._shares[worker][each]] for each in local], local]],
                _RUNNING,
            ]
            for worker, local in parts.items()
        }
        reports: dict[int, Any] = {}
        for worker, (worker_reports, running) in self._workers.run(calls).items():
            reports.update(zip((self._shares[worker][each] for each in parts[worker]), worker_reports or ()))
            ended = set(self._running[worker]).difference(running)
            self._running[worker] = running
            if ended:  # keep the outcome in case the worker is lost later
                outcomes = self._results([worker])
                self._final.update({index: outcomes[index] for index in outcomes if self._owner[index][1] in ended})
        return [self._report(index, reports.get(index)) for index in env_idx_list]

    def is_episode_end(self) -> bool:
        """Return whether the episodes of all environments have ended."""
        return not self.get_running_env_idx_list()

    def get_running_env_idx_list(self) -> list[int]:
        """Return the environments whose episode goes on."""
        if not self._seeds:
            raise RuntimeError("no episode has begun: call reset first")
        alive = [worker for worker, reason in enumerate(self._workers.lost) if not reason]
        return [self._shares[worker][local] for worker in alive for local in self._running[worker]]

    def results(self) -> list[Result]:
        """Return the outcome of every environment's episode so far.

        One that was lost in its episode has success and score None, `end_reason` "infrastructure" and an `error`.
        """
        if not self._seeds:
            raise RuntimeError("no episode has begun: call reset first")
        outcomes = self._results(range(len(self._shares)))
        return [
            outcomes.get(env) or self._final.get(env) or self._infrastructure_error(env) for env in range(self._total)
        ]

    def finish_episode(self) -> None:
        """Call `finish_episode` of the environments, if they have it."""
        if _FINISH in self._workers.methods:
            self._workers.run({worker: [[_FINISH, []]] for worker in range(len(self._shares))})

    def render(self, env_idx: int = 0, camera: str | None = None) -> Any:
        """Return the current image of a camera, (H, W, 3) uint8 RGB, for people.

        Raises:
            ValueError: there is no such environment or camera.
            EnvRaisedError: the environment cannot render.
            EnvLostError: the environment is lost.
        """
        ((worker, local),) = self._by_worker([env_idx]).items()
        answers = self._workers.query({worker: [[_RENDER, [*local, camera]]]})
        if worker not in answers:
            raise EnvLostError(self._workers.lost[worker])
        return answers[worker][0]

    def close(self) -> None:
        """Close the environments and end their processes."""
        self._workers.close()

    # -- indices -------------------------------------------------------------------------------------------------------

    def _only_index(self) -> int:
        if self._total != 1:
            raise ValueError(f"there are {self._total} environments; use get_obs_batch and take_action_batch")
        return 0

    def _by_worker(self, indices: Iterable[int]) -> dict[int, list[int]]:
        """Return the local indices of some environments, by worker."""
        parts: dict[int, list[int]] = {}
        for index in indices:
            if index not in self._owner:
                raise ValueError(f"there is no environment {index}; indices go from 0 to {self._total - 1}")
            worker, local = self._owner[index]
            parts.setdefault(worker, []).append(local)
        return parts

    def _store_observations(self, worker: int, local: Iterable[int], observations: Iterable[ObservationDict]) -> None:
        for each, obs in zip(local, observations):
            index = self._shares[worker][each]
            self._last[index] = {**obs, spec.Obs.ENV_IDX: index}

    def _report(self, index: int, env_report: Any) -> Report:
        report = {**(env_report or {}), spec.Obs.ENV_IDX: index}
        if self._workers.lost[self._owner[index][0]]:
            report["end_reason"] = self._final.get(index, {}).get("end_reason", INFRASTRUCTURE)
        return report

    def _results(self, workers: Iterable[int]) -> dict[int, Result]:
        """Return the outcomes of the environments of running workers."""
        return {
            index: {**result, spec.Obs.ENV_IDX: index}
            for worker, (outcomes,) in self._workers.run({worker: [_RESULTS] for worker in workers}).items()
            for index, result in zip(self._shares[worker], outcomes)
        }

    def _infrastructure_error(self, env: int) -> Result:
        return {
            spec.Obs.ENV_IDX: env,
            spec.Deploy.SEED: self._seeds[env],
            "success": None,
            "score": None,
            "end_reason": INFRASTRUCTURE,
            "error": self._workers.lost[self._owner[env][0]],
        }
