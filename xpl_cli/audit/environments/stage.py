"""The fact about environments: one played in a process of its own, with a time limit on every call."""

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
from xpl_cli.audit.environments.trial import Trial
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
"""Control steps of one trial: enough to move, few enough for every pull request."""
MAKE_S, CALL_S = 150.0, 60.0
_ABSENT = frozenset(("ModuleNotFoundError", "ImportError", "NotInstalledError", "RendererMissingError"))
"""What an environment raises where the machine, and not the environment, is to blame."""
SWING, SHIFT, OPENING = 0.02, 0.005, 0.1
"""The motion that trials make about the start pose: rad, m, and part of the gripper's range."""


_MANY = 5
"""Tasks; with more, whoever waits is told why it takes long."""


@dataclass(frozen=True)
class Offer:
    """One combination that env.yml offers."""

    task: str
    embodiment: str
    action_type: str

    def __str__(self) -> str:
        return f"{self.task} with {self.embodiment} in {self.action_type} control"

    @property
    def robot(self) -> Embodiment:
        """The embodiment."""
        return get_embodiment(self.embodiment)


class Play:
    """An environment that was made; its operations, each of which may raise what `EnvProcess` raises."""

    def __init__(self, process: EnvProcess, about: Announcement) -> None:
        self._process = process
        self.guarded = bool(about["guarded"])

    def call(self, method: str, *arguments: Any) -> Any:
        """Call an operation and return what it returns."""
        return self.calls([[method, list(arguments)]])[0]

    def calls(self, asked: Sequence[Sequence[Any]]) -> list[Any]:
        """Call several operations, one after the other, and return what each returns."""
        # A reset may load a scene and compile code, which takes as long as making it.
        limit_s = MAKE_S if any(method == sdk.Method.RESET for method, _ in asked) else CALL_S
        answers: list[Any] = _ask(self._process, RUN, asked, limit_s)
        return answers

    def reset(self, *seeds: int) -> None:
        """Begin episodes."""
        self.call(sdk.Method.RESET, list(seeds))

    def observe(self, *envs: int) -> list[ObservationDict]:
        """Return observations, of all running environments by default."""
        found: list[ObservationDict] = self.call("get_obs_batch", list(envs) or None)
        return found

    def act(self, actions: Mapping[int, Action]) -> list[object] | None:
        """Execute one action step in some environments; return what the environment reports of each."""
        found: list[object] | None = self.call("take_action_batch", list(actions.values()), list(actions))
        return found

    def running(self) -> list[int]:
        """Return the environments whose episode goes on."""
        found: list[int] = self.call("get_running_env_idx_list")
        return found

    def results(self) -> list[Result]:
        """Return the outcome of every environment's episode."""
        found: list[Result] = self.call("results")
        return found

    def trial(self, offer: Offer, *seeds: int, steps: int = STEPS) -> list[Trial]:
        """Play so many steps of a small motion in every environment."""
        self.reset(*seeds)
        first = self.observe()
        seen = [[obs] for obs in first]
        for step in range(steps):
            running = self.running()
            if not running:
                break
            moves = {env: motion(offer, first[env], step) for env in running}
            _, after = self.calls(
                [["take_action_batch", [list(moves.values()), running]], ["get_obs_batch", [running]]]
            )
            for env, obs in zip(running, after, strict=True):
                seen[env].append(obs)
        return [Trial(tuple(each), result) for each, result in zip(seen, self.results(), strict=True)]


class Stage:
    """One environment package, and processes in which its environments are made.

    Args:
        path: the package's folder.
        options: how it is audited; `--set` gives keys of its configuration, of which task, embodiment and action_type
            narrow what is tried.
    """

    def __init__(self, path: Path, options: AuditOptions) -> None:
        self.path = path
        self.manifest = environments.manifest(path)
        self._options = options
        self._process: EnvProcess | None = None
        self._heard = hashlib.sha256()
        self._open = contextlib.ExitStack()

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()
            self._process = None
        self._open.close()

    def record(self) -> str:
        """Return the hash of what was seen in all trials."""
        return self._heard.hexdigest()

    @cached_property
    def offers(self) -> tuple[Offer, ...]:
        """Every combination of task, robot and action type that env.yml offers, as far as it is asked for.

        Raises:
            NotApplicable: there is none.
            NotRun: env.yml does not say what is offered; the static gate reports why.
        """
        problems = validate(self.manifest.data, "env")
        unknown = [] if problems else [name for name in self.manifest.embodiments if name not in robots.names()]
        if problems or unknown:
            raise NotRun(f"env.yml is not understood: {problems[0].message if problems else f'no robot {unknown[0]}'}")
        asked = self._options.overrides
        found = tuple(
            Offer(task, robot, action_type)
            for task, entry in self.manifest.tasks.items()
            for robot in (get_embodiment(name).name for name in self.manifest.embodiments)
            for action_type in self.manifest.action_types
            if unsupported(entry, robot) is None
            and asked.get("task") in (None, task)
            and asked.get("embodiment") in (None, robot)
            and asked.get(sdk.Deploy.ACTION_TYPE) in (None, action_type)
        )
        if not found:
            raise NotApplicable("env.yml offers no task with any of its robots that was asked for")
        tasks = list(dict.fromkeys(offer.task for offer in found))
        if len(tasks) > _MANY:
            self._options.progress.step(
                f"{self.path.name}: most rules play each of {len(tasks)} tasks; --set task={tasks[0]} audits one"
            )
        return found

    @property
    def is_real(self) -> bool:
        """Whether a robot may stand behind it: there is one of it, and it repeats nothing to the last bit."""
        return self.manifest.is_real

    @property
    def give(self) -> float:
        """How far two observations of an arm at rest may differ: not at all in a simulation."""
        return 0.05 if self.is_real else 0.0

    def require_repeats(self) -> None:
        """Stop a rule that compares episodes with one another, or plays two at once.

        Raises:
            NotApplicable: a robot may stand behind the environment.
        """
        if self.is_real:
            raise NotApplicable(
                "env.yml does not say `real_time: false`: there is one robot, and it repeats no episode"
            )

    @property
    def tasks(self) -> list[Offer]:
        """Offers in which every task and every action type comes up, and different robots."""
        return _covering(self.offers, lambda offer: {offer.task, offer.action_type})

    @property
    def robots(self) -> list[Offer]:
        """Offers in which every task comes up, and every robot with every action type."""
        return _covering(self.offers, lambda offer: {offer.task, (offer.embodiment, offer.action_type)})

    @property
    def cameras(self) -> Any:
        """What is asked for where pictures are looked at: all, unless `--set cameras=...` says otherwise."""
        return self._options.overrides.get("cameras", True)

    @property
    def truth(self) -> dict[str, bool]:
        """Configuration that shows the simulator's truth, where env.yml says that it can be shown."""
        return {sdk.Obs.PRIVILEGED: True} if self.manifest.privileged else {}

    @contextlib.contextmanager
    def play(self, offer: Offer, *, fresh: bool = False, **config: object) -> Iterator[Play]:
        """Make an environment.

        Args:
            offer: what is played.
            fresh: in a new process, where nothing was made before.
            config: further keys of the configuration; no pictures by default.

        Raises:
            NotRun: the machine lacks what it needs.
            EnvRaisedError, EnvLostError: it cannot be made.
        """
        given = {"cameras": False, **self._options.overrides, **config}
        asked = {**given, "task": offer.task, "embodiment": offer.embodiment, sdk.Deploy.ACTION_TYPE: offer.action_type}
        self._options.time_limit.check()
        process = self._started() if fresh else self._shared()
        try:
            about = _ask(process, MAKE, {"client": str(self._client()), "config": asked}, MAKE_S)
            yield Play(process, about)
            if not fresh:
                _ask(process, CLOSE, None, CALL_S)
        except EnvLostError:
            self._process = None if process is self._process else self._process
            raise
        except EnvRaisedError as error:
            if error.kind in _ABSENT:
                raise NotRun(f"{error.message} (in the Python of the environment, {self._python})") from None
            raise
        finally:
            if fresh:
                process.close()

    def trial(self, offer: Offer, *seeds: int, fresh: bool = False, **config: object) -> list[Trial]:
        """Make one environment for each seed, play a trial, and note what was seen."""
        with self.play(offer, fresh=fresh, num_envs=len(seeds), **config) as play:
            trials = play.trial(offer, *seeds)
        for trial in trials:
            self._heard.update(f"{offer} {trial.result.get('digest')} {len(trial.seen)}\n".encode())
        return trials

    def finding(self, text: str, *, expected: str, got: str, advice: str) -> Finding:
        """Return a finding on the client file."""
        file = self.manifest.client
        return Finding(text, path=file, line=1, column=1, expected=expected, got=got, fix=Fix("advice", advice))

    def told(self, findings: Iterator[Finding], expected: str) -> Iterator[Finding]:
        """Yield findings; an environment that raises or dies while they are looked for is one itself."""
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
    def _confined(self) -> dict[str, Any]:
        """What keeps the environment within bounds, as the options ask for it."""
        options = self._options
        try:
            kept = self._open.enter_context(options.bounds.isolate_adapter(self.path))
        except UserError as error:
            raise NotRun(str(error)) from None
        return {} if kept is None else {"prefix": kept.prefix, "environment": kept.environment(os.environ)}

    def _client(self) -> Path:
        return self.path / self.manifest.client

    def _shared(self) -> EnvProcess:
        if self._process is None:
            self._process = self._started()
        return self._process

    def _started(self) -> EnvProcess:
        try:
            # A robot that --move lets move is moved by rules, not by trials that people lay out and judge.
            confined = {"environment": os.environ, **self._confined}
            confined["environment"] = {**confined["environment"], ASKS: "no"}
            return EnvProcess(self._python, **confined)
        except OSError as error:
            raise NotRun(f"{self._python} cannot be started: {error.strerror}") from None


def motion(offer: Offer, first: ObservationDict, step: int) -> dict[str, np.ndarray]:
    """Return the action of a small motion around the state of an episode's first observation.

    Raises:
        NotRun: the state lacks what actions of this type command; the rule `env-observations` reports that.
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


def _covering(offers: Sequence[Offer], aspects: Callable[[Offer], set[object]]) -> list[Offer]:
    """Return few offers with every aspect that any offer has, changing robots from one to the next."""
    left = set().union(*(aspects(offer) for offer in offers))
    chosen: list[Offer] = []
    while left:
        used = [offer.embodiment for offer in chosen]
        best = max(offers, key=lambda offer: (len(left & aspects(offer)), -used.count(offer.embodiment)))
        chosen.append(best)
        left -= aspects(best)
    return chosen


def _ask(process: EnvProcess, op: str, value: object, limit_s: float) -> Any:
    process.send(message(op, value), limit_s)
    return process.receive()
