"""The fact `env_probe`: an environment that runs in a separate process, with a time limit on every call."""

from __future__ import annotations

import contextlib
import hashlib
import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl import get_embodiment, robots
from xpl.arms.people import ASKS
from xpl.simulator.process import EnvLostError, EnvProcess, EnvRaisedError, message
from xpl.simulator.worker import CLOSE, MAKE, RUN
from xpl_cli.audit.environments.observed_episode import ObservedEpisode
from xpl_cli.audit.rules.model import Finding, Fix, NotApplicable, NotRun
from xpl_cli.basics.errors import UserError
from xpl_cli.environments.check import unsupported
from xpl_cli.lifecycle import interpreter
from xpl_cli.packages import environments
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from xpl import Embodiment
    from xpl.contract import Action, Announcement, ObservationDict, Result
    from xpl_cli.audit.rules.options import AuditOptions

STEPS = 12
"""Control steps of one episode: enough to move, few enough for every pull request."""
MAKE_S, CALL_S = 150.0, 60.0
_MISSING_REQUIREMENT = frozenset(("ModuleNotFoundError", "ImportError", "NotInstalledError", "RendererMissingError"))
"""Exceptions of an environment that mean that the machine lacks a requirement."""
SWING, SHIFT, OPENING = 0.02, 0.005, 0.1
"""Amplitudes of the motion about the start pose: rad, m, and part of the gripper's range."""


_MANY = 5
"""With more tasks than this, a message says why the audit takes long."""


@dataclass(frozen=True)
class Offer:
    """One combination of task, embodiment and action type in env.yml."""

    task: str
    embodiment: str
    action_type: str

    def __str__(self) -> str:
        return f"{self.task} with {self.embodiment} in {self.action_type} control"

    @property
    def robot(self) -> Embodiment:
        """The embodiment."""
        return get_embodiment(self.embodiment)


class RunningEnv:
    """The operations of an environment in a process; each may raise the errors of `EnvProcess`."""

    def __init__(self, process: EnvProcess, about: Announcement) -> None:
        self._process = process
        self.guarded = bool(about["guarded"])

    def call(self, method: str, *arguments: Any) -> Any:
        """Call an operation and return its result."""
        return self.calls([[method, list(arguments)]])[0]

    def calls(self, requests: Sequence[Sequence[Any]]) -> list[Any]:
        """Call several operations, one after the other, and return their results."""
        # A reset may load a scene and compile code, which takes as long as creating the environment.
        limit_s = MAKE_S if any(method == sdk.Method.RESET for method, _ in requests) else CALL_S
        answers: list[Any] = _request(self._process, RUN, requests, limit_s)
        return answers

    def reset(self, *seeds: int) -> None:
        """Begin episodes."""
        self.call(sdk.Method.RESET, list(seeds))

    def observe(self, *envs: int) -> list[ObservationDict]:
        """Return observations, of all running environments by default."""
        observations: list[ObservationDict] = self.call("get_obs_batch", list(envs) or None)
        return observations

    def act(self, actions: Mapping[int, Action]) -> list[object] | None:
        """Execute one action step in some environments; return the environment's reports."""
        reports: list[object] | None = self.call("take_action_batch", list(actions.values()), list(actions))
        return reports

    def running(self) -> list[int]:
        """Return the indices of environments whose episode is running."""
        indices: list[int] = self.call("get_running_env_idx_list")
        return indices

    def results(self) -> list[Result]:
        """Return the outcome of every environment's episode."""
        outcomes: list[Result] = self.call("results")
        return outcomes

    def run_motion(self, offer: Offer, *seeds: int, steps: int = STEPS) -> list[ObservedEpisode]:
        """Run so many steps of a small motion in every environment."""
        self.reset(*seeds)
        first = self.observe()
        observations = [[obs] for obs in first]
        for step in range(steps):
            running = self.running()
            if not running:
                break
            moves = {env: motion(offer, first[env], step) for env in running}
            _, after = self.calls(
                [["take_action_batch", [list(moves.values()), running]], ["get_obs_batch", [running]]]
            )
            for env, obs in zip(running, after, strict=True):
                observations[env].append(obs)
        return [ObservedEpisode(tuple(each), result) for each, result in zip(observations, self.results(), strict=True)]


class EnvProbe:
    """One environment package, and the processes that run its environments.

    Args:
        path: the package's folder.
        options: options of the audit; `--set` sets keys of its configuration, of which task, embodiment and action_type
            select offers.
    """

    def __init__(self, path: Path, options: AuditOptions) -> None:
        self.path = path
        self.manifest = environments.manifest(path)
        self._options = options
        self._process: EnvProcess | None = None
        self._episode_digest = hashlib.sha256()
        self._open = contextlib.ExitStack()

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
            self._process = None
        self._open.close()

    def record(self) -> str:
        """Return the hash of all episodes."""
        return self._episode_digest.hexdigest()

    @cached_property
    def offers(self) -> tuple[Offer, ...]:
        """Every combination of task, robot and action type in env.yml that the options select.

        Raises:
            NotApplicable: there is none.
            NotRun: env.yml is invalid; the static gate reports why.
        """
        problems = validate(self.manifest.data, "env")
        unknown = [] if problems else [name for name in self.manifest.embodiments if name not in robots.names()]
        if problems or unknown:
            raise NotRun(f"env.yml is not understood: {problems[0].message if problems else f'no robot {unknown[0]}'}")
        overrides = self._options.overrides
        offers = tuple(
            Offer(task, robot, action_type)
            for task, entry in self.manifest.tasks.items()
            for robot in (get_embodiment(name).name for name in self.manifest.embodiments)
            for action_type in self.manifest.action_types
            if unsupported(entry, robot) is None
            and overrides.get("task") in (None, task)
            and overrides.get("embodiment") in (None, robot)
            and overrides.get(sdk.Deploy.ACTION_TYPE) in (None, action_type)
        )
        if not offers:
            raise NotApplicable("env.yml offers no task with any of its robots that was asked for")
        tasks = list(dict.fromkeys(offer.task for offer in offers))
        if len(tasks) > _MANY:
            self._options.progress.step(
                f"{self.path.name}: most rules play each of {len(tasks)} tasks; --set task={tasks[0]} audits one"
            )
        return offers

    @property
    def is_real(self) -> bool:
        """Whether it may be a real robot: there is only one, and its episodes are not repeatable."""
        return self.manifest.is_real

    @property
    def rest_tolerance(self) -> float:
        """Largest difference between two observations of an arm at rest: 0 in a simulation."""
        return 0.05 if self.is_real else 0.0

    def require_repeats(self) -> None:
        """Skip a rule that compares episodes, or runs two at once.

        Raises:
            NotApplicable: if the environment may be a real robot.
        """
        if self.is_real:
            raise NotApplicable(
                "env.yml does not say `real_time: false`: there is one robot, and it repeats no episode"
            )

    @property
    def tasks(self) -> list[Offer]:
        """Offers that cover every task and every action type, with different robots."""
        return _cover(self.offers, lambda offer: {offer.task, offer.action_type})

    @property
    def robots(self) -> list[Offer]:
        """Offers that cover every task, and every robot with every action type."""
        return _cover(self.offers, lambda offer: {offer.task, (offer.embodiment, offer.action_type)})

    @property
    def cameras(self) -> Any:
        """The value of `cameras` for rules that check images: all cameras, unless `--set cameras=...` selects some."""
        return self._options.overrides.get("cameras", True)

    @property
    def privileged_config(self) -> dict[str, bool]:
        """Configuration that requests ground truth, if env.yml declares it."""
        return {sdk.Obs.PRIVILEGED: True} if self.manifest.privileged else {}

    @contextlib.contextmanager
    def make_env(self, offer: Offer, *, fresh: bool = False, **config: object) -> Iterator[RunningEnv]:
        """Create an environment.

        Args:
            offer: task, embodiment and action type.
            fresh: use a new process.
            config: further keys of the configuration; no images by default.

        Raises:
            NotRun: if the machine lacks a requirement.
            EnvRaisedError, EnvLostError: if it cannot be created.
        """
        defaults = {"cameras": False, **self._options.overrides, **config}
        config_of_env = {
            **defaults,
            "task": offer.task,
            "embodiment": offer.embodiment,
            sdk.Deploy.ACTION_TYPE: offer.action_type,
        }
        self._options.time_limit.check()
        process = self._start_process() if fresh else self._shared_process()
        try:
            about = _request(process, MAKE, {"client": str(self._client()), "config": config_of_env}, MAKE_S)
            yield RunningEnv(process, about)
            if not fresh:
                _request(process, CLOSE, None, CALL_S)
        except EnvLostError:
            self._process = None if process is self._process else self._process
            raise
        except EnvRaisedError as error:
            if error.kind in _MISSING_REQUIREMENT:
                raise NotRun(f"{error.message} (in the Python of the environment, {self._python})") from None
            raise
        finally:
            if fresh:
                process.close()

    def run_episodes(self, offer: Offer, *seeds: int, fresh: bool = False, **config: object) -> list[ObservedEpisode]:
        """Run one episode for each seed in one batch, and record its digest."""
        with self.make_env(offer, fresh=fresh, num_envs=len(seeds), **config) as running_env:
            trials = running_env.run_motion(offer, *seeds)
        for trial in trials:
            self._episode_digest.update(f"{offer} {trial.result.get('digest')} {len(trial.observations)}\n".encode())
        return trials

    def finding(self, text: str, *, expected: str, got: str, advice: str) -> Finding:
        """Return a finding on the client file."""
        file = self.manifest.client
        return Finding(text, path=file, line=1, column=1, expected=expected, got=got, fix=Fix("advice", advice))

    def report_failure(self, findings: Iterator[Finding], expected: str) -> Iterator[Finding]:
        """Yield findings, and one more if the environment raises an error or its process ends."""
        try:
            yield from findings
        except (EnvRaisedError, EnvLostError) as error:
            yield self.finding(
                f"the environment fails: {error}",
                expected=expected,
                got=str(error),
                advice="its own output, above, shows where",
            )

    @cached_property
    def _python(self) -> str:
        options = self._options
        try:
            return interpreter.resolve(self.path, self.manifest.environment, python=options.python, env=options.env)
        except UserError as error:
            hint = f" ({error.hint})" if error.hint else ""
            raise NotRun(f"{error}{hint}") from None

    @cached_property
    def _sandbox(self) -> dict[str, Any]:
        """Arguments of `EnvProcess` for the isolation that the options request."""
        options = self._options
        try:
            sandbox = self._open.enter_context(options.bounds.isolate_adapter(self.path))
        except UserError as error:
            raise NotRun(str(error)) from None
        return {} if sandbox is None else {"prefix": sandbox.prefix, "environment": sandbox.environment(os.environ)}

    def _client(self) -> Path:
        return self.path / self.manifest.client

    def _shared_process(self) -> EnvProcess:
        if self._process is None:
            self._process = self._start_process()
        return self._process

    def _start_process(self) -> EnvProcess:
        try:
            # With --move, rules move the robot; no person is asked to lay out and judge trials.
            sandbox = {"environment": os.environ, **self._sandbox}
            sandbox["environment"] = {**sandbox["environment"], ASKS: "no"}
            return EnvProcess(self._python, **sandbox)
        except OSError as error:
            raise NotRun(f"{self._python} cannot be started: {error.strerror}") from None


def motion(offer: Offer, first: ObservationDict, step: int) -> dict[str, np.ndarray]:
    """Return the action of a small motion around the state of an episode's first observation.

    Raises:
        NotRun: the state lacks a key of the action; the rule `env-observations` reports that.
    """
    state = first[sdk.Obs.STATE]
    action = {}
    for key, dim in offer.robot.dims(offer.action_type).items():
        if key not in state:
            raise NotRun(f"{offer}: the state has no {key}, so that no motion can begin from it")
        value = np.array(state[key], dtype=np.float32)
        phase = np.sin(0.7 * step + np.arange(dim))
        if key.endswith(sdk.State.EE_POSE):
            value[: sdk.POSITION_DIM] += (SHIFT * phase)[: sdk.POSITION_DIM]
        elif key.endswith(sdk.State.ARM_JOINT_STATE):
            value += np.float32(SWING) * phase
        else:
            value = np.clip(value + OPENING * phase, sdk.GRIPPER_CLOSED, sdk.GRIPPER_OPEN)
        action[key] = value.astype(np.float32)
    return action


def _cover(offers: Sequence[Offer], aspects: Callable[[Offer], set[object]]) -> list[Offer]:
    """Return few offers that have all aspects of all offers, with different robots if possible."""
    missing = set().union(*(aspects(offer) for offer in offers))
    chosen: list[Offer] = []
    while missing:
        used = [offer.embodiment for offer in chosen]
        best = max(offers, key=lambda offer: (len(missing & aspects(offer)), -used.count(offer.embodiment)))
        chosen.append(best)
        missing -= aspects(best)
    return chosen


def _request(process: EnvProcess, op: str, value: object, limit_s: float) -> Any:
    process.send(message(op, value), limit_s)
    return process.receive()
